"""A run that is resumed by the command is the run that it was: settings, maps, and what was changed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from athrl_driving.maps.town import _FOLDER as TOWNS
from athrl_protocol.run_file import read_run_file, saved_toml, with_whole_maps

SECONDS = 200.0


def test_containers_made_anew_without_their_settings_keep_those_of_the_run(
    command, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = f"tcp/127.0.0.1:{port}"
    compose = [
        "learner",
        "--resume-if-present",
        "--set",
        "run.name=2024",
        "--set",
        f"network.listen={address}",
    ]
    monkeypatch.setenv("ATHRL_SET", "run.environment_steps=40000 learner.batch=64 replay.capacity=5000")
    first = command.start(*compose)
    command.wait_until_said(first, "listens at", SECONDS)
    first.terminate()
    assert first.wait(timeout=SECONDS) == 0

    monkeypatch.setenv("ATHRL_SET", "learner.batch=32")
    second = command.start(*compose)
    command.wait_until_said(second, "listens at", SECONDS)
    status = json.loads(command.run("status", "--connect", address, "--json", seconds=SECONDS).stdout)
    second.terminate()
    assert second.wait(timeout=SECONDS) == 0
    assert (status["run"], status["environment_steps_target"]) == ("2024", 40_000)
    assert status["changes"] == ["learner.batch was 64 and is 32, from step 0"]
    assert command.said(second).count("athrl_learner.run_changes") == 1
    assert "setting learner.batch was 64 and is 32" in command.said(second)


@pytest.mark.parametrize("service", [["learner"], ["train", "--serial"]])
def test_run_is_not_resumed_in_another_map_of_the_same_name(command, service: list[str]) -> None:
    folder = Path(command.folder) / "runs" / "mine"
    folder.mkdir(parents=True)
    town = Path(command.folder) / "m.xodr"
    shutil.copy(TOWNS / "town02.xodr", town)
    serial = f"serial.enabled={str('--serial' in service).lower()}"
    settings = read_run_file(None, [f"environment.towns={town}", serial])
    (folder / "run.toml").write_text(saved_toml(with_whole_maps(settings)))
    shutil.copy(TOWNS / "town04.xodr", town)
    result = command.run(*service, "--resume", "mine", seconds=SECONDS)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert f"{town} is another map than the run's" in result.stderr


def test_run_that_goes_on_in_another_map_says_so_or_is_refused(command) -> None:
    folder, here = Path(command.folder) / "runs" / "mine", Path(command.folder)
    folder.mkdir(parents=True)
    (here / "moved").mkdir()
    shutil.copy(TOWNS / "town02.xodr", here / "m.xodr")
    shutil.copy(TOWNS / "town04.xodr", here / "moved" / "m.xodr")
    settings = read_run_file(None, [f"environment.towns={here}/m.xodr"])
    (folder / "run.toml").write_text(saved_toml(with_whole_maps(settings)))
    check = ["learner", "--resume", "mine", "--check", "--set"]
    result = command.run(*check, "environment.towns=town04", seconds=SECONDS)
    assert result.returncode == 0
    assert f"runs/mine goes on in another town than before: was {here}/m.xodr, is town04" in result.stderr
    for words in (check, ["train", "--resume", "mine", "--set"]):
        result = command.run(*words, "environment.towns=moved/m.xodr", seconds=SECONDS)
        assert result.returncode == 2
        assert result.stderr.count("\n") == 1
        assert "moved/m.xodr (SHA-256 " in result.stderr
        assert f"is another map than {here}/m.xodr" in result.stderr
