"""A client without a certificate of the run's authority is refused with an error, and the log shows it."""

from __future__ import annotations

import contextlib
import datetime
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh
from athrl.certificates import AUTHORITY, Identity, _load_authority, _new_role, _write_role
from athrl_protocol import LearnerNotFound, NotAdmitted, ProtocolError, fetch_run_file, open_session
from athrl_protocol.security.certificates import find_certificates

from athrl import certificates

SECONDS = 200.0
PATIENCE = 30.0


@pytest.fixture(scope="module")
def watched_folder(_authorities: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificates of the run that several tests look at."""
    return Path(shutil.copytree(_authorities["ours"], tmp_path_factory.mktemp("watched") / "ours"))


@pytest.fixture(scope="module")
def watched(shared_command, another_tiny, free_port: Callable[[], int], watched_folder: Path):
    """`athrl learner` as a process, which knows services by certificates and logs who connects; its port."""
    port = free_port()
    words = another_tiny({"network.listen": f"tcp/127.0.0.1:{port}", "run.name": "guarded"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATHRL_LOG", "debug")
        process = shared_command.start("learner", *words, "--certificates", str(watched_folder))
    shared_command.wait_until_said(process, "listens at", SECONDS)
    return process, port


class Watched(NamedTuple):
    """The learner that several tests look at, as one of them sees it."""

    port: int
    ours: Path
    said: Callable[[], str]
    """What it has said since the test began."""


@pytest.fixture
def learner_process(shared_command, watched, watched_folder: Path) -> Iterator[Watched]:
    """The learner that all these tests share, which survives each of them."""
    process, port = watched
    before = len(shared_command.said(process))
    yield Watched(port, watched_folder, lambda: shared_command.said(process)[before:])
    assert process.poll() is None, shared_command.said(process)


def one_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    lines = result.stderr.splitlines()
    assert result.returncode == 2, result.stderr
    assert len(lines) == 1, result.stderr
    for word in words:
        assert word in lines[0], lines[0]


def status(command, port: int, *certificates: str, protocol: str = "tls") -> subprocess.CompletedProcess[str]:
    address = f"{protocol}/127.0.0.1:{port}"
    return command.run("status", "--connect", address, "--json", *certificates, seconds=SECONDS)


def test_learner_names_the_address_at_which_it_really_listens(shared_command, watched) -> None:
    process, port = watched
    assert f"listens at tls/127.0.0.1:{port}" in shared_command.said(process)


def test_only_the_authoritys_certificates_get_in(
    command, learner_process: Watched, foreign: Path, eventually
) -> None:
    port, ours, said = learner_process
    one_line(
        status(command, port, "--certificates", str(foreign)),
        "its certificate is not accepted",
        str(foreign / "viewer"),
    )
    one_line(status(command, port, protocol="tcp"), "asks for a certificate", "--certificates")
    one_line(status(command, port), "needs certificates", "--certificates")
    assert said().count("a connection was refused") >= 2, said()

    admitted = status(command, port, "--certificates", str(ours))
    assert admitted.returncode == 0, admitted.stderr
    alone = status(command, port, "--certificates", str(ours / "viewer"))
    assert alone.returncode == 0, alone.stderr
    connected = "athrl_protocol.connections connected with the certificate 'viewer'"
    eventually(lambda: connected in said(), SECONDS)


def test_each_container_can_ask_whether_it_takes_part_with_its_own_certificate(
    command, learner_process: Watched
) -> None:
    port, ours, said = learner_process
    address = ["--connect", f"127.0.0.1:{port}"]
    for role in ("learner", "actor", "evaluator"):
        asked = ["status", *address, "--check", "learner", "--certificates", str(ours / role)]
        result = command.run(*asked, seconds=SECONDS)
        assert result.returncode == 0, result.stderr
    assert "not allowed" not in said()


def test_denied_deed_is_in_the_learners_log(learner_process: Watched, eventually) -> None:
    port, ours, said = learner_process
    with open_session(
        connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="actor", certificates=ours
    ) as session:
        session.put("athrl/guarded/policy", b"forged")
        eventually(
            lambda: "not allowed: Put on 'athrl/guarded/policy' with the certificate 'actor'" in said(),
            SECONDS,
        )
        session.put("athrl/guarded/metrics/actor/rig", b"0" * 1_000_000)
        eventually(
            lambda: (
                "too large: Put on 'athrl/guarded/metrics/actor/rig' with the certificate 'actor'" in said()
            ),
            SECONDS,
        )


def test_certificate_without_a_role_may_do_nothing(
    command, learner_process: Watched, tmp_path: Path, eventually
) -> None:
    port, ours, said = learner_process
    stranger = tmp_path / "stranger"
    authority: Identity = _load_authority(ours)
    _write_role(stranger, _new_role(authority, "stranger", [], days=1), authority)
    with open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, certificates=stranger) as session:
        with pytest.raises(
            LearnerNotFound, match="; maybe the learner does not permit that with this certificate"
        ):
            fetch_run_file(session, "guarded", timeout=2.0)
        received_keys: list[str] = []
        session.declare_subscriber("athrl/**", lambda sample: received_keys.append(str(sample.key_expr)))
        eventually(lambda: "'stranger' from" in said(), SECONDS)
        eventually(lambda: "has no role in this run" in said(), SECONDS)
        # The learner has published its state in this time.
        admitted = status(command, port, "--certificates", str(ours))
        assert admitted.returncode == 0, admitted.stderr
        assert received_keys == []


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_client_without_a_certificate_gets_no_link(
    learner: zenoh.Session, port: int, ours: Path, protocol
) -> None:
    """With Zenoh alone, not with our own program, which would not even try."""
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    configuration.insert_json5("connect/endpoints", f'["{protocol}/127.0.0.1:{port}"]')
    configuration.insert_json5("connect/timeout_ms", "1000")
    configuration.insert_json5("connect/exit_on_failure", "true")
    authority = ours / AUTHORITY / "tls.crt"
    configuration.insert_json5("transport/link/tls/root_ca_certificate", f'"{authority}"')
    with pytest.raises(zenoh.ZError):
        zenoh.open(configuration)
    assert learner.info.links() == []


def test_nobody_else_can_pass_for_the_learner(sessions, port: int, ours: Path) -> None:
    """Of all roles only the learner's certificate may serve: a stolen actor's is not believed."""
    impostor = ours / "impostor"
    (ours / "actor").rename(impostor)
    sessions.enter_context(
        open_session(listen=f"127.0.0.1:{port}", timeout=PATIENCE, run="guarded", certificates=impostor)
    )
    with pytest.raises(NotAdmitted, match="its certificate is not accepted"):
        open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="viewer", certificates=ours)


def test_service_does_not_start_with_a_certificate_that_no_client_would_accept(
    command, tiny: list[str], port: int, ours: Path
) -> None:
    """An actor's key mounted at the learner: no client could join, and it would wait forever."""
    wrong = ("--certificates", str(ours / "actor"))
    result = command.run("learner", *tiny, "--set", "run.name=guarded", *wrong, seconds=SECONDS)
    one_line(result, "actor/tls.crt", "unsuitable certificate purpose", "a learner")
    address = f"127.0.0.1:{port}"
    result = command.run("router", "--listen", address, "--connect", address, *wrong, seconds=SECONDS)
    one_line(result, "actor/tls.crt", "unsuitable certificate purpose", "a router")


def test_certificate_of_another_role_is_refused_before_a_learner_is_looked_for(
    command, tiny: list[str], ours: Path
) -> None:
    for role, other in (("actor", "viewer"), ("evaluator", "learner")):
        result = command.run(role, "--certificates", str(ours / other), seconds=SECONDS)
        one_line(result, f"ours/{other}: its certificate is for the role {other}", f"be for {role}")


def test_run_is_not_begun_with_the_certificate_of_a_single_role(command, tiny: list[str], ours: Path) -> None:
    """Its actors and its evaluator could not connect, and it would wait for them forever."""
    by_setting = ["--set", f"network.certificates={ours / 'learner'}"]
    for words in (["--certificates", str(ours / "learner")], by_setting):
        result = command.run("train", *tiny, *words, seconds=SECONDS)
        one_line(result, "ours/learner: it has the certificate of the role learner alone")
    assert not list(command.folder.rglob("run.toml"))


def test_who_may_not_see_all_of_a_run_is_told_so(command, learner_process: Watched) -> None:
    port, ours, _ = learner_process
    for role in ("actor", "evaluator"):
        result = status(command, port, "--certificates", str(ours / role))
        assert result.returncode == 0
        assert result.stderr.count("\n") == 1
        assert f"its role {role} may not read evaluations" in result.stderr
    for role in ("viewer", "learner"):
        assert status(command, port, "--certificates", str(ours / role)).stderr == ""


def test_run_with_certificates_is_not_resumed_without_them(command, tiny: list[str], ours: Path) -> None:
    """It would accept every client without a warning."""
    shown = ("--certificates", str(ours))
    process = command.start("learner", *tiny, "--set", "run.name=guarded", *shown)
    command.wait_until_said(process, "listens at tls/", SECONDS)
    process.terminate()
    assert process.wait(timeout=SECONDS) == 0
    others_reach_it = ["--set", "network.listen=tcp/0.0.0.0:7447"]
    once_more = [*tiny, "--set", "run.name=guarded", *others_reach_it, "--resume-if-present"]
    for without in (["--resume", "guarded"], once_more):
        one_line(command.run("learner", *without, seconds=SECONDS), "tls/", "--certificates")
    process = command.start("learner", "--resume", "guarded", *shown)
    command.wait_until_said(process, "listens at tls/", SECONDS)
    process.terminate()
    assert process.wait(timeout=SECONDS) == 0


def test_expired_certificate_is_named_by_who_would_serve_with_it(ours: Path, monkeypatch) -> None:
    monkeypatch.setattr(certificates, "CLOCK_DIFFERENCE", datetime.timedelta(days=9))
    certificates.renew_roles(ours, ["learner"], None, days=-1)
    shown = find_certificates(ours, "learner")
    assert shown is not None
    with pytest.raises(ProtocolError, match=r"learner/tls.crt is no .* \(certificate has expired\)"):
        shown.check_may_serve("learner")


def test_expired_certificate_is_named(learner: zenoh.Session, port: int, ours: Path, monkeypatch) -> None:
    monkeypatch.setattr(certificates, "CLOCK_DIFFERENCE", datetime.timedelta(days=9))
    certificates.renew_roles(ours, ["viewer"], None, days=-1)
    with pytest.raises(NotAdmitted, match=r"it refuses .*viewer/tls.crt \(certificate expired\)"):
        open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="viewer", certificates=ours)


def test_address_that_is_not_in_the_learners_certificate_is_named(sessions, port: int, ours: Path) -> None:
    certificates.renew_roles(ours, ["learner"], ["somewhere.example"], days=1)
    sessions.enter_context(
        open_session(listen=f"127.0.0.1:{port}", timeout=PATIENCE, run="guarded", certificates=ours)
    )
    with pytest.raises(NotAdmitted, match=r"127\.0\.0\.1.*not accepted"):
        open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="viewer", certificates=ours)


def test_learner_without_encryption_is_named(sessions, port: int, ours: Path) -> None:
    sessions.enter_context(open_session(listen=f"127.0.0.1:{port}", timeout=PATIENCE))
    with pytest.raises(LearnerNotFound, match=r"does not answer in TLS: .* has no certificates"):
        open_session(connect=f"127.0.0.1:{port}", timeout=5.0, role="viewer", certificates=ours)


def test_forwarder_whose_learner_is_away_is_no_refusal(port: int, ours: Path) -> None:
    """Like a published port of a container, or a balancer: it accepts without a server and closes."""
    with socket.create_server(("127.0.0.1", port)) as forwarder:
        over = threading.Event()

        def accept_and_close() -> None:
            while not over.is_set():
                with contextlib.suppress(OSError):
                    forwarder.accept()[0].close()

        threading.Thread(target=accept_and_close, daemon=True).start()
        try:
            with pytest.raises(LearnerNotFound):
                open_session(connect=f"127.0.0.1:{port}", timeout=5.0, role="actor", certificates=ours)
        finally:
            over.set()


def test_folder_without_certificates_is_named(port: int, ours: Path, tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"cannot read .*nothing/ca.crt: no such file"):
        open_session(connect=f"127.0.0.1:{port}", timeout=1.0, certificates=tmp_path / "nothing")
    os.replace(ours / "actor" / "tls.key", ours / "viewer" / "tls.key")
    with pytest.raises(ProtocolError, match=r"viewer/tls.key is not the key of"):
        open_session(connect=f"127.0.0.1:{port}", timeout=1.0, certificates=ours)
