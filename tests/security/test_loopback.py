"""A run on this machine can only be reached from this machine, unless other settings are given."""

from __future__ import annotations

import ipaddress
import socket
from pathlib import Path

import psutil
import pytest
from athrl_protocol import RunFile

SECONDS = 600.0  # an actor that starts for the first time compiles the simulation


def listening(command) -> set[tuple[str, str, int]]:
    """Return (kind, address, port) of every socket at which a process of the command can be reached."""
    found = set()
    for process in command.left():
        try:
            for connection in process.net_connections(kind="inet"):
                waits = connection.status == psutil.CONN_LISTEN or connection.type == socket.SOCK_DGRAM
                if waits and connection.laddr:
                    kind = "udp" if connection.type == socket.SOCK_DGRAM else "tcp"
                    found.add((kind, connection.laddr.ip, connection.laddr.port))
        except psutil.Error:
            continue
    return found


@pytest.mark.timeout(1500)
@pytest.mark.parametrize("encrypted", [False, True])
def test_local_run_listens_at_loopback_only(
    command, tiny: list[str], port: int, unused_port: int, ours: Path, eventually, encrypted: bool
) -> None:
    certificates = ["--certificates", str(ours)] if encrypted else []
    settings = ["--set", "run.environment_steps=100000", "--actors", "1", "--viewer-port", str(unused_port)]
    train = command.start("train", *tiny, *settings, *certificates)
    seen: set[tuple[str, str, int]] = set()

    def everybody_is_there() -> bool:
        seen.update(listening(command))
        ports = {place[2] for place in seen}
        logs = command.folder / "runs" / "town03" / "logs"
        return {port, unused_port} <= ports and all(
            (logs / f"{name}.log").is_file() for name in ("actor-1", "evaluator", "viewer")
        )

    eventually(everybody_is_there, SECONDS)
    address = ["--connect", f"127.0.0.1:{port}", *certificates]
    for who in ("actor/actor-1", "evaluator"):
        eventually(
            lambda who=who: command.run("status", *address, "--check", who, seconds=SECONDS).returncode == 0,
            SECONDS,
        )
        everybody_is_there()
    assert train.poll() is None, command.said(train)
    elsewhere = {place for place in seen if not ipaddress.ip_address(place[1]).is_loopback}
    assert elsewhere == set()


def test_default_addresses_are_loopback() -> None:
    assert RunFile().network.listen == "tcp/127.0.0.1:7447"
