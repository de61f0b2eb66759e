"""A certificate that is bound to an actor's name permits this name alone, and the name to nobody else."""

from __future__ import annotations

import contextlib
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from athrl.certificate_files import common_name, load_certificate
from athrl.errors import CommandError
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    Keys,
    PresenceWatcher,
    ProtocolError,
    RunFile,
    announce_presence,
    encode_chunk,
    new_incarnation,
    open_session,
    serve_run_file,
)
from athrl_protocol.security.certificates import find_certificates, read_bound_names
from athrl_protocol.transport.session import open_router

from athrl import certificates

RUN = "guarded"
KEYS = Keys(RUN)
PATIENCE = 30.0
Connect = Callable[..., zenoh.Session]


@pytest.fixture
def ours(ours: Path) -> Path:
    """Certificates of the run's authority, with one that is bound to the name rig."""
    certificates.bind_actors(ours, ["rig", "other.rig_2"], days=2)
    return ours


@pytest.fixture
def intake(learner: zenoh.Session, sessions: contextlib.ExitStack) -> ChunkIntake:
    run_file = RunFile()
    named = run_file.model_copy(update={"run": run_file.run.model_copy(update={"name": RUN})})
    sessions.enter_context(serve_run_file(learner, named))
    return sessions.enter_context(ChunkIntake(learner, RUN, lambda chunk: None))


@pytest.fixture(params=["at the learner", "behind a router"])
def connect(
    request, intake: ChunkIntake, sessions: contextlib.ExitStack, ours: Path, port: int, unused_port: int
) -> Connect:
    """Opens an actor's session with a certificate of the folder."""
    address = f"tls/127.0.0.1:{port}"
    if request.param == "behind a router":
        router = open_router(
            listen=f"tls/127.0.0.1:{unused_port}", connect=address, run=RUN, certificates=ours
        )
        sessions.enter_context(router)
        address = f"tls/127.0.0.1:{unused_port}"

    def opened(name: str) -> zenoh.Session:
        session = open_session(connect=address, timeout=PATIENCE, role="actor", name=name, certificates=ours)
        return sessions.enter_context(session)

    return opened


def answers(session: zenoh.Session, key: str, chunk: Chunk) -> list[bool]:
    """Upload a chunk under a key; return for each answer whether it is an acknowledgement."""
    replies = session.get(key, payload=encode_chunk(chunk), timeout=2.0)
    return [reply.ok is not None for reply in replies]


def test_each_actor_uploads_under_its_own_name_only(
    intake: ChunkIntake, connect: Connect, make_chunk: Callable[[], Chunk]
) -> None:
    bound, shared = connect("rig"), connect("anybody")
    for session, name in ((bound, "rig"), (shared, "anybody")):
        with ChunkUploader(session, RUN, name, new_incarnation(), capacity=4) as uploader:
            assert uploader.submit(make_chunk(), PATIENCE)
            assert uploader.flush(PATIENCE)
            assert uploader.statistics().acknowledged == 1
    for session, forged in ((bound, "anybody"), (bound, "other.rig_2"), (shared, "rig")):
        chunk = replace(make_chunk(), actor=forged, incarnation=new_incarnation())
        assert answers(session, KEYS.experience(forged), chunk) == []
    assert intake.statistics().chunks == 2
    # Under its own key, or one for all actors, the name in the chunk is compared.
    chunk = replace(make_chunk(), actor="rig", incarnation=new_incarnation())
    assert answers(shared, KEYS.experience("anybody"), chunk) == [False]
    assert True not in answers(shared, KEYS.every_experience, chunk)
    assert intake.statistics().chunks == 2


def test_bound_name_is_shown_and_reported_by_its_owner_only(
    learner: zenoh.Session, connect: Connect, sessions: contextlib.ExitStack, received, eventually
) -> None:
    bound, shared = connect("rig"), connect("anybody")
    arrived = received()
    learner.declare_subscriber(KEYS.every_metrics, arrived)
    watcher = sessions.enter_context(PresenceWatcher(learner, RUN))
    for session, own, foreign in ((shared, "anybody", "rig"), (bound, "rig", "anybody-else")):
        sessions.enter_context(announce_presence(session, RUN, "actor", foreign))
        sessions.enter_context(announce_presence(session, RUN, "actor", own))

        def report(session=session, own=own, foreign=foreign) -> bool:
            session.put(KEYS.metrics("actor", foreign), b"forged")
            session.put(KEYS.metrics("actor", own), own.encode())
            return KEYS.metrics("actor", own) in arrived.keys

        eventually(report, PATIENCE)  # a router may not know yet that somebody listens
        eventually(report, PATIENCE)
        assert watcher.wait_for(lambda there, own=own: ("actor", own) in there, PATIENCE)
    assert b"forged" not in arrived.payloads
    assert {name for _, name in watcher.present()} >= {"rig", "anybody"}
    assert ("actor", "anybody-else") not in watcher.present()


def test_names_are_kept_for_the_servers_and_folders_for_their_owners(ours: Path) -> None:
    place = ours / "actors" / "rig"
    assert sorted(path.name for path in place.iterdir()) == ["ca.crt", "tls.crt", "tls.key"]
    assert stat.S_IMODE((place / "tls.key").stat().st_mode) == 0o600
    assert common_name(load_certificate(place / "tls.crt")) == "actor/rig"
    for server in ("learner", "router"):
        found = find_certificates(ours, server)
        assert found is not None
        assert read_bound_names(found) == ("rig", "other.rig_2")
    (place / "tls.key").rename(ours / "moved away")
    place.rename(ours / "handed out")
    assert certificates.complete(ours, ["localhost"], 2, actors=["third"]) == ["actors/third"]
    assert (ours / "learner" / "actors.txt").read_text().split() == ["rig", "other.rig_2", "third"]


def test_bound_certificate_is_made_once_and_renewed_by_its_name(ours: Path) -> None:
    with pytest.raises(CommandError, match=r"actors/rig already holds .* --renew actor/rig"):
        certificates.bind_actors(ours, ["fourth", "rig"], days=2)
    assert not (ours / "actors" / "fourth").exists()
    before = (ours / "actors" / "rig" / "tls.crt").read_bytes()
    certificates.renew_roles(ours, ["actor/rig"], None, days=2)
    assert (ours / "actors" / "rig" / "tls.crt").read_bytes() != before
    with pytest.raises(CommandError, match=r"one of learner, .* actor/other\.rig_2, actor/rig"):
        certificates.renew_roles(ours, ["actor/nobody"], None, days=2)


@pytest.mark.parametrize("line", ["two words", "../rig", "x" * 59])
def test_wrong_name_in_the_servers_list_is_one_line(ours: Path, line: str) -> None:
    (ours / "learner" / "actors.txt").write_text(f"rig\n{line}\n")
    found = find_certificates(ours, "learner")
    assert found is not None
    with pytest.raises(ProtocolError, match=r"learner/actors\.txt: actor ") as error:
        read_bound_names(found)
    assert "\n" not in str(error.value)


def test_command_binds_and_renews(command, tmp_path: Path) -> None:
    folder = tmp_path / "made"
    for options in (["--actor", "rig,other"], ["--actor", "third"], ["--renew", "actor/rig"]):
        result = command.run("certificates", str(folder), *options, seconds=60)
        assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(f"{folder}/actors/rig: valid until ")
    assert (folder / "router" / "actors.txt").read_text() == "rig\nother\nthird\n"
    result = command.run("certificates", str(folder), "--renew", "actor", "--actor", "rig", seconds=60)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)


def test_wrong_name_and_anothers_certificate_are_one_line(command, ours: Path) -> None:
    for name in ("a b", "x" * 59, ""):
        result = command.run("certificates", str(ours), "--actor", name, seconds=60)
        assert result.returncode == 2
        assert result.stderr.startswith(f"athrl: --actor {name}: actor {name!r} cannot be "), result.stderr
    place = ours / "actors" / "rig"
    result = command.run("actor", "--certificates", str(place), "--name", "other", seconds=60)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "its certificate is bound to the actor rig, --name is other" in result.stderr
