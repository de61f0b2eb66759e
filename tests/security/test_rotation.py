"""New certificates of the same authority are accepted during the run, and nothing is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
import zenoh
from athrl_protocol import open_session

from athrl import certificates

SECONDS = 120.0
COMPILING = 600.0
"""An actor that starts for the first time after a change of the simulation compiles it."""
PATIENCE = 30.0
RUN = "guarded"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_run_goes_on_while_certificates_are_renewed(
    command, tiny: list[str], port: int, ours: Path, eventually
) -> None:
    settings = [*tiny, "--set", f"run.name={RUN}", "--set", "run.environment_steps=1000000"]
    shown = ["--certificates", str(ours)]
    where = ["--connect", f"127.0.0.1:{port}", "--run", RUN]

    def status() -> dict[str, Any]:
        result = command.run("status", *where, *shown, "--json", seconds=SECONDS)
        return json.loads(result.stdout) if result.returncode == 0 else {}

    def steps() -> int:
        return int(status().get("environment_steps", 0))

    def grows_beyond(reached: int) -> None:
        eventually(lambda: steps() > reached, COMPILING)

    def stop(process: subprocess.Popen[str]) -> None:
        os.kill(process.pid, signal.SIGTERM)
        process.wait(timeout=SECONDS)

    learner = command.start("learner", *settings, *shown)
    actor = command.start("actor", *where, *shown, "--name", "rig")
    grows_beyond(0)

    assert command.run("certificates", str(ours), "--renew", "actor", seconds=SECONDS).returncode == 0
    stop(actor)
    reached = steps()
    actor = command.start("actor", *where, *shown, "--name", "rig")
    grows_beyond(reached)

    assert command.run("certificates", str(ours), "--renew", "learner", seconds=SECONDS).returncode == 0
    reached = steps()
    stop(learner)
    learner = command.start("learner", "--resume", RUN, "--set", "run.folder=runs", *shown)
    grows_beyond(reached)

    assert actor.poll() is None, command.said(actor)
    counts = status()["learner"]
    assert counts["intake/lost"] == 0
    assert counts["intake/invalid"] == 0
    stop(actor)
    stop(learner)


def test_connected_client_shows_its_new_certificate_when_it_connects_again(
    sessions, port: int, ours: Path, foreign: Path, eventually
) -> None:
    """A session that stays open reads its files for every connection, so no service has to be restarted."""

    def listen() -> zenoh.Session:
        return open_session(listen=f"127.0.0.1:{port}", timeout=PATIENCE, run=RUN, certificates=ours)

    learner = listen()
    client = sessions.enter_context(
        open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="viewer", certificates=ours)
    )
    eventually(lambda: len(client.info.links()) == 1, PATIENCE)
    learner.close()
    for name in ("tls.crt", "tls.key"):  # a certificate that is not trusted: it is indeed read again
        (ours / "viewer" / name).write_bytes((foreign / "viewer" / name).read_bytes())
    learner = listen()
    try:
        probe = open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role="actor", certificates=ours)
        probe.close()
        assert client.info.links() == []
        certificates.renew_roles(ours, ["viewer", "learner"], None, days=2)
        eventually(lambda: len(client.info.links()) == 1, PATIENCE)
    finally:
        learner.close()
