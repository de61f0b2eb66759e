"""An endpoint that cannot be, or that everybody would reach, is refused in one line at the start."""

from __future__ import annotations

import socket

import pytest

SECONDS = 100.0


def one_line(result) -> str:
    assert result.returncode == 2, result.stdout + result.stderr
    lines = [line for line in result.stderr.splitlines() if line.startswith("athrl: ")]
    assert len(lines) == 1
    assert "Traceback" not in result.stderr
    return lines[0]


@pytest.mark.parametrize(
    "arguments",
    [
        ["learner", "--set", "metrics.listen=0.0.0.0:9464"],
        ["evaluator", "--metrics-listen", "0.0.0.0:9464"],
        ["router", "--listen", "tcp/127.0.0.1:7448", "--metrics-listen", "0.0.0.0:9464"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_every_address_is_refused_unless_it_is_said(command, arguments: list[str]) -> None:
    line = one_line(command.run(*arguments, seconds=SECONDS))
    assert "write every-address:9464 if that is meant, or 9464 for loopback" in line
    assert not list(command.folder.glob("runs"))


def test_port_in_use_is_refused_and_leaves_no_run(command, tiny: list[str], free_port) -> None:
    with socket.create_server(("127.0.0.1", free_port())) as taken:
        port = taken.getsockname()[1]
        learner = ["learner", *tiny, "--set", f"metrics.listen={port}"]
        line = one_line(command.run(*learner, seconds=SECONDS))
        assert f"cannot serve metrics at 127.0.0.1:{port}: another process listens there" in line
        evaluator = ["evaluator", "--connect", f"tcp/127.0.0.1:{free_port()}", "--metrics-listen", str(port)]
        assert f"127.0.0.1:{port}" in one_line(command.run(*evaluator, seconds=SECONDS))
    assert not list(command.folder.glob("runs/*/run.toml"))


@pytest.mark.parametrize("given", ["in use", "the learner's", "no address"])
def test_evaluators_port_is_checked_before_train_starts_anything(
    command, tiny: list[str], free_port, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    with socket.create_server(("127.0.0.1", free_port())) as taken:
        used, free = taken.getsockname()[1], free_port()
        port, said = {
            "in use": (used, f"cannot serve metrics at 127.0.0.1:{used}: another process listens there"),
            "the learner's": (free, f"cannot serve metrics at 127.0.0.1:{free}"),
            "no address": ("nine", "'nine' is no address for metrics"),
        }[given]
        monkeypatch.setenv("ATHRL_METRICS_LISTEN", str(port))
        line = one_line(command.run("train", *tiny, "--set", f"metrics.listen={free}", seconds=SECONDS))
    assert f"ATHRL_METRICS_LISTEN, for the evaluator: {said}" in line
    assert not list(command.folder.glob("runs/*"))
