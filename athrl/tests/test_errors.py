"""What the command says is one line that any terminal can show, whatever it quotes."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from athrl.errors import CommandError, say
from athrl.train.comparison import comparison_tables, read_comparison
from rich.console import Console

SCORES = dict.fromkeys(
    ("episodes", "return_mean", "return_ci95", "speed_mps", "distance_m", "collision_rate", "off_lane_rate",
     "full_episode_rate", "driving_score"), 1.0,
)  # fmt: skip


def test_message_has_no_character_that_steers_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    say("no run '\x1b[2J\x07'\n there")
    assert capsys.readouterr().err == "athrl: no run '\\u001b[2J\\u0007' there\n"


@pytest.mark.parametrize("words", [["train", "--resume"], ["status", "--certificates"]])
def test_path_that_is_too_long_is_one_line(words: list[str]) -> None:
    command = [sys.executable, "-m", "athrl", *words, "x" * 300]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 2
    assert result.stderr.startswith("athrl: xxx")
    assert result.stderr.endswith(": file name too long\n")
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["certificates", ""],
        ["study", "study.toml", "--out", ""],
        ["evaluate", "--policy", "blind", "--record", ""],
    ],
)
def test_empty_path_is_not_taken_for_the_present_folder(words: list[str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "athrl", *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr == (
        "athrl: the folder's path is empty: name a folder, with . for the one you are in\n"
    )
    assert not list(tmp_path.iterdir())


def test_wrong_option_of_a_command_below_another_points_to_its_own_help() -> None:
    command = [sys.executable, "-m", "athrl", "maps", "check", "town03", "--vehicles", "-1"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 2
    assert result.stderr.startswith("athrl: --vehicles -1: should be an integer, >= 1")
    assert result.stderr.endswith("; see athrl maps check --help\n")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--name", "a b"], "actor 'a b' cannot be used"),
        (["--run", "town 03"], "run name 'town 03' cannot be used"),
    ],
)
def test_name_that_cannot_be_is_refused_before_a_learner_is_waited_for(words: list[str], told: str) -> None:
    command = [sys.executable, "-m", "athrl", "actor", "--connect", "tcp/127.0.0.1:1", *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 2
    assert result.stderr.startswith(f"athrl: {told}: letters, digits")
    assert result.stderr.count("\n") == 1


def comparison(**other: Any) -> dict[str, Any]:
    drivers = {"policy": SCORES, "[/red]": SCORES}
    return {"policy_version": 3, "town": "maps/[1].xodr", "drivers": drivers, **other}


def test_closing_comparison_shows_names_as_they_are() -> None:
    document = comparison(towns={"maps/[1].xodr": {"policy": SCORES, "[/red]": SCORES}})
    shown = io.StringIO()
    for table in comparison_tables(document):
        Console(file=shown, width=120).print(table)
    assert "[/red]" in shown.getvalue()
    assert "maps/[1].xodr" in shown.getvalue()


@pytest.mark.parametrize(
    "wrong",
    [{"drivers": []}, {"drivers": {}}, {"policy_version": None}, {"drivers": {"policy": {"episodes": 1}}},
     {"drivers": {"policy": {**SCORES, "speed_mps": "fast"}}}, {"towns": 3}, {"drivers": {"policy": 1}}],
)  # fmt: skip
def test_closing_comparison_of_nonsense_is_one_line(wrong: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "evaluation.json").write_text(json.dumps(comparison(**wrong)))
    with pytest.raises(CommandError, match="the closing comparison cannot be shown") as caught:
        comparison_tables(read_comparison(tmp_path, since=0.0))
    assert "\n" not in str(caught.value)
