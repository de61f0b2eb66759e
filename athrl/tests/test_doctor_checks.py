"""Single checks of `athrl doctor`, each with the thing that it looks for."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from athrl.certificates import _load_authority, _new_role, _write_role, make_all
from athrl.doctor import command, disk, installation, machine, network, round_trip
from athrl.doctor.finding import Finding, Level, findings_of, ok
from athrl.doctor.round_trip import count, delivery_trial, synthetic_chunk
from athrl.errors import CommandError
from athrl_driving.kernels.machine_code import copy_code
from athrl_learner import factories
from athrl_learner.log import Kind, SegmentLog, numbered_segments
from athrl_protocol import Chunk, encode_chunk
from athrl_protocol.announcements.address_file import ADDRESS_FILE
from athrl_protocol.run_file import RunFile, read_run_file
from athrl_protocol.security.certificates import ROLES

from athrl import certificates

HOSTS = ["127.0.0.1"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Certificates of every role."""
    make_all(tmp_path / "certificates", HOSTS, 300)
    return tmp_path / "certificates"


def settings(*overrides: str) -> RunFile:
    return read_run_file(None, overrides)


def looked_at(folder: Path) -> list[Finding]:
    return list(network.certificates(settings(f"network.certificates={folder}")))


def worst(found: list[Finding]) -> Finding:
    order = list(Level)
    return max(found, key=lambda finding: order.index(finding.level))


def make_again(folder: Path, role: str, *, as_role: str, days: int) -> None:
    authority = _load_authority(folder)
    _write_role(folder / role, _new_role(authority, as_role, HOSTS, days), authority)


def test_folder_of_a_run_leads_to_its_learner(tmp_path: Path, free_address: Callable[[], str]) -> None:
    def found() -> Finding:
        checks = dict(command._checks(settings(), str(tmp_path), None))
        (finding,) = findings_of("learner", checks["learner"])
        return finding

    assert f"no learner runs there: {tmp_path} has no {ADDRESS_FILE}" in found().seen
    (tmp_path / ADDRESS_FILE).write_text(address := free_address())
    assert f"no learner at {address}" in found().seen


def test_good_certificates_are_good(folder: Path) -> None:
    found = looked_at(folder)
    assert [finding.level for finding in found] == [Level.OK] * len(ROLES)
    assert all("valid until" in finding.seen for finding in found)


def test_folder_of_a_single_role_is_looked_at(folder: Path) -> None:
    (found,) = looked_at(folder / "actor")
    assert (found.check, found.level) == ("certificate actor", Level.OK)


def test_certificate_that_is_bound_to_an_actor_is_looked_at(folder: Path) -> None:
    certificates.bind_actors(folder, ["rig"], days=90)
    for found in (looked_at(folder)[-1], looked_at(folder / "actors" / "rig")[0]):
        assert (found.check, found.level) == ("certificate actor/rig", Level.OK)


def test_expired_certificate_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        certificates, "CLOCK_DIFFERENCE", 30 * certificates.CLOCK_DIFFERENCE.__class__(days=1)
    )
    make_again(folder, "evaluator", as_role="evaluator", days=-1)
    found = worst(looked_at(folder))
    assert found.level is Level.FAILED
    assert found.check == "certificate evaluator"
    assert "expired on" in found.seen
    assert found.remedy == f"athrl certificates {folder} --renew evaluator"


def test_certificate_that_ends_soon_is_a_warning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        certificates, "CLOCK_DIFFERENCE", 30 * certificates.CLOCK_DIFFERENCE.__class__(days=1)
    )
    make_again(folder, "viewer", as_role="viewer", days=3)
    found = worst(looked_at(folder))
    assert (found.check, found.level) == ("certificate viewer", Level.WARNING)


def test_certificate_of_another_role_is_named(folder: Path) -> None:
    make_again(folder, "actor", as_role="viewer", days=300)
    found = worst(looked_at(folder))
    assert (found.check, found.level) == ("certificate actor", Level.FAILED)
    assert "'viewer'" in found.seen


def test_certificate_of_another_authority_is_named(folder: Path, tmp_path: Path) -> None:
    make_all(tmp_path / "other", HOSTS, 300)
    (folder / "actor" / "ca.crt").write_bytes((tmp_path / "other" / "actor" / "ca.crt").read_bytes())
    assert "is not of the authority" in worst(looked_at(folder)).seen


def test_key_that_others_may_read_is_a_warning(folder: Path) -> None:
    (folder / "learner" / "tls.key").chmod(0o644)
    found = worst(looked_at(folder))
    assert (found.check, found.level) == ("certificate learner", Level.WARNING)
    assert "chmod 600" in found.remedy


def test_missing_key_is_a_finding_and_the_others_are_looked_at(folder: Path) -> None:
    (folder / "learner" / "tls.key").unlink()
    found = looked_at(folder)
    assert len(found) == len(ROLES)
    assert worst(found).level is Level.FAILED
    assert "tls.key" in worst(found).seen


def test_open_address_without_certificates_is_a_warning(monkeypatch: pytest.MonkeyPatch, port: int) -> None:
    monkeypatch.delenv("ATHRL_CERTIFICATES", raising=False)
    found = list(network.port(settings(f"network.listen=tcp/0.0.0.0:{port}")))
    assert worst(found).level is Level.WARNING
    assert "without certificates" in worst(found).seen


def test_address_with_encryption_fits_certificates(
    folder: Path, monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    """As the run file in the folder of a run with certificates has it."""
    monkeypatch.delenv("ATHRL_CERTIFICATES", raising=False)
    listen = f"network.listen=tls/0.0.0.0:{port}"
    (fitting,) = network.port(settings(listen, f"network.certificates={folder}"))
    assert fitting.level is Level.OK
    (without,) = findings_of("port", lambda: network.port(settings(listen)))
    assert "needs certificates" in without.seen


def test_folder_that_cannot_be_written_is_named() -> None:
    found = list(disk.disk(settings("run.folder=/proc/self")))
    assert found[0].level is Level.FAILED
    assert "cannot write" in found[0].seen


def test_disk_of_the_run_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_run = settings(f"run.folder={tmp_path / 'runs'}", "durability.reserve_mebibytes=1")
    found = {finding.check: finding for finding in disk.disk(of_run)}
    assert found["run folder"].seen == f"{tmp_path} can be written"
    assert found["disk speed"].seen.endswith("MiB/s")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(disk, "SLOW_MEBIBYTES_PER_SECOND", 1e9)
    assert {each.check: each.level for each in disk.disk(of_run)}["disk speed"] is Level.WARNING


def test_chunks_are_logged_on_the_disk_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = []

    def trial(folder: Path, chunks: int, fsync: str) -> round_trip.Outcome:
        outcome = delivery_trial(folder, 300, fsync)
        folders.append((folder.parent, len(numbered_segments(folder)), fsync))
        return outcome._replace(acknowledged=chunks)

    monkeypatch.setattr(round_trip, "delivery_trial", trial)
    of_run = settings(
        f"run.folder={tmp_path / 'runs'}",
        "durability.reserve_mebibytes=1",
        "durability.fsync=acknowledgement",
    )
    (found,) = round_trip.round_trip(of_run)
    assert found.level is Level.OK, found.seen
    assert folders == [(tmp_path, 2, "acknowledgement")]
    assert str(tmp_path) in found.seen
    assert not list(tmp_path.iterdir())


def test_replay_is_sized_as_the_learner_sizes_it() -> None:
    of_run = settings("replay.capacity=5000")
    real = factories.make_replay(of_run, factories.make_agent(of_run)).bytes
    assert machine.replay_bytes(of_run) == pytest.approx(real, rel=0.1)


def test_each_town_of_the_run_is_looked_at(tmp_path: Path) -> None:
    gone = tmp_path / "gone.xodr"
    settings = read_run_file(
        None, [f'environment.towns={{town02=1, "{gone}"=1}}', "environment.vehicles=158"]
    )
    here, missing = machine.towns(settings)
    assert here == ok("towns", "town02 has room for 158 vehicles")
    assert (missing.level, missing.seen) == (Level.FAILED, f"{gone}: there is no such file")
    (full,) = machine.towns(read_run_file(None, ["environment.towns=town02", "environment.vehicles=159"]))
    assert full.seen == "environment.vehicles is 159, town02 has room for 158"


def test_simulation_is_told_where_its_code_is_or_that_it_has_no_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, readable = tmp_path / "athrl-compiled-1", tmp_path / "installation" / "code"
    (readable / "episode").mkdir(parents=True)
    (own / "episode").mkdir(parents=True)
    monkeypatch.setattr("athrl_driving.kernels.compilation.cache_folder", lambda: str(own))
    (without,) = machine.simulation()
    assert without.level is Level.WARNING
    assert "NUMBA_CACHE_DIR" in without.remedy
    (readable / "episode" / "drive.nbi").touch()
    copy_code(readable, own)
    assert list(machine.simulation()) == [ok("simulation", "compiled, in a folder that can only be read")]


def test_service_of_another_release_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    version: Callable[[str], str] = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "9.9" if name == "athrl-actor" else version(name))
    found = [finding for finding in installation.installation() if finding.check == "services"]
    assert found[0].level is Level.FAILED
    assert "athrl-actor 9.9" in found[0].seen


def test_missing_dependency_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    requires: Callable[[str], list[str] | None] = metadata.requires
    monkeypatch.setattr(metadata, "requires", lambda name: [*(requires(name) or []), "no-such-thing>=3"])
    found = [finding for finding in installation.installation() if finding.check == "dependencies"]
    assert found[0].level is Level.FAILED
    assert "no-such-thing" in found[0].seen


def test_delivery_trial_loses_nothing(tmp_path: Path) -> None:
    outcome = delivery_trial(tmp_path, 300)
    assert (outcome.acknowledged, outcome.lost, outcome.twice) == (300, 0, 0)
    assert len(numbered_segments(tmp_path)) >= 2, "the receiver was killed and started again"


def test_trial_does_not_wait_for_ever_for_a_receiver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    silent = tmp_path / "python"
    silent.write_text("#!/bin/sh\nexec sleep 200\n")
    silent.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(silent))
    monkeypatch.setattr(round_trip, "START_SECONDS", 0.2)
    with pytest.raises(CommandError, match="the receiver does not start: it printed nothing"):
        delivery_trial(tmp_path, 3)


def test_receiver_of_the_trial_loads_no_torch() -> None:
    program = "import sys, athrl.doctor.light_learner; print('torch' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200)
    assert result.stdout.strip() == "False", result.stderr


def test_count_finds_what_is_missing_and_what_is_there_twice(tmp_path: Path) -> None:
    log = SegmentLog(tmp_path, segment_bytes=2**20, fsync="never")
    for number in (0, 1, 1, 3):
        log.append(Kind.CHUNK, encode_chunk(_numbered(number)))
    log.close()
    outcome = count(tmp_path, 4, 0.0)
    assert (outcome.lost, outcome.twice) == (1, 1)


def _numbered(number: int) -> Chunk:
    return replace(synthetic_chunk(number), sequence=number)


def test_expected_error_in_a_check_is_a_finding_and_a_bug_is_not() -> None:
    def expected():
        yield ok("a", "fine")
        raise CommandError("what the user\ncan mend")

    def bug():
        yield ok("a", "fine")
        raise KeyError("x")

    found = list(findings_of("a", expected))
    assert [finding.level for finding in found] == [Level.OK, Level.FAILED]
    assert found[1].seen == "what the user can mend"
    with pytest.raises(KeyError):
        list(findings_of("a", bug))


def test_doctor_needs_no_torch_and_no_simulation(port: int) -> None:
    program = (
        "import sys\n"
        "for name in ('torch', 'athrl_learner', 'athrl_driving', 'athrl_planners', 'onnxruntime', 'rerun'):\n"
        "    sys.modules[name] = None\n"
        "from athrl.command import main\n"
        f"sys.argv = ['athrl', 'doctor', '--set', 'network.listen=tcp/127.0.0.1:{port}']\n"
        "main()\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=200, env={**os.environ}
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "not tested: no learner is installed here" in result.stdout
    assert "Traceback" not in result.stderr
