"""Output that takes ASCII only does no harm to any command."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest
from athrl.display import Display
from athrl.errors import CommandError
from athrl.evaluate.output import print_scores
from athrl.output import _HANDLER, accept_any_text, console, start_log
from athrl.run_view import RunSnapshot
from athrl.train.comparison import comparison_tables
from athrl_protocol import (
    EvaluationPublisher,
    EvaluationResult,
    Phase,
    RunFile,
    RunState,
    StatePublisher,
    announce_presence,
    open_session,
    serve_run_file,
)
from rich.console import Console
from rich.table import Table

PATIENCE = 120.0
SCORES = {
    "episodes": 2.0,
    "return_mean": 812.0,
    "return_ci95": 90.5,
    "speed_mps": 5.1,
    "distance_m": 380.0,
    "collision_rate": 0.25,
    "off_lane_rate": 0.0,
    "full_episode_rate": 1.0,
    "driving_score": 0.9,
}
RESULT = EvaluationResult("policy", 6, 1_400, "town03", 1, SCORES)
STATE = RunState(Phase.TRAINING, 1_500, 6_000, 320, 7, "the learner waits for data")


def printed(*words: str, **environment: str) -> str:
    """What a command prints where standard output and standard error take ASCII only."""
    result = subprocess.run(
        [sys.executable, "-m", "athrl", *words],
        env={**os.environ, "PYTHONIOENCODING": "ascii", **environment}, capture_output=True,
        timeout=PATIENCE, check=False,
    )  # fmt: skip
    said = result.stderr.decode("ascii")
    assert (result.returncode, said) == (0, ""), said
    return result.stdout.decode("ascii")


@pytest.mark.parametrize("words", [["policies", "--json"], ["--help"]])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_full_disk_under_the_output_is_told_in_one_line(words: list[str], unbuffered: str) -> None:
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "athrl", *words],
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered}, stdout=full, stderr=subprocess.PIPE,
            text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip
    told = "athrl: standard output cannot be written: no space left on device; make room and try again\n"
    assert (result.returncode, result.stderr) == (2, told)


def test_reader_that_has_seen_enough_is_no_error() -> None:
    shell = f"{sys.executable} -m athrl policies --json | true; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(
        ["bash", "-c", shell], env={**os.environ, "PYTHONUNBUFFERED": ""}, stderr=subprocess.PIPE,
        timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, b"")


def test_help_has_borders_of_ascii() -> None:
    assert "| train " in printed("--help")


def test_table_of_policies_says_plus_minus() -> None:
    assert "return 3344 +- 49" in printed("policies")


def test_run_file_is_printed_in_the_locale_c() -> None:
    assert "[learner]" in printed("run-file", LANG="C", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")


def test_status_of_a_run_with_a_score_is_shown(address: str) -> None:
    run = RunFile().run.name
    with (
        open_session(listen=address, timeout=PATIENCE) as learner,
        serve_run_file(learner, RunFile()),
        announce_presence(learner, run, "learner", "learner"),
        announce_presence(learner, run, "evaluator", "evaluator"),
        StatePublisher(learner, run) as states,
        EvaluationPublisher(learner, run) as results,
    ):
        states.publish(STATE)
        results.publish(RESULT)
        shown = printed("status", "--connect", address)
    assert "return 812 +- 90.5" in shown
    assert "320 updates (-/s) - replay" in shown


def test_lines_of_a_run_and_its_closing_table_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii", write_through=True))
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    accept_any_text()
    snapshot = RunSnapshot(RunFile(), STATE, {}, {"policy": RESULT}, frozenset())
    with Display() as display:
        display.say("mit Ä, 東京")
        display.show(snapshot, [])
    for table in comparison_tables({"policy_version": 6, "town": "x", "drivers": {"policy": SCORES}}):
        Console().print(table)
    text = written.getvalue().decode("ascii")
    assert "scored return 812 +- 90.5" in text
    assert "812 +- 90 " in text
    assert r"mit \xc4, \u6771\u4eac" in text


@pytest.mark.parametrize("name", [b"\xff", "ü".encode()])
def test_name_of_a_file_that_is_no_text_is_written_in_any_encoding(name: bytes) -> None:
    accept_any_text()
    text = os.fsdecode(name)
    for encoding in ("ascii", "latin-1", "utf-8"):
        assert text.encode(encoding, _HANDLER)


def test_level_of_the_log_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATHRL_LOG", "loud")
    with pytest.raises(CommandError, match=r"^ATHRL_LOG=loud: should be debug, info, warning or error$"):
        start_log()


def test_tables_show_names_of_files_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table(title="[bold]x.xodr", show_header=False)
    table.add_row("[/red].xodr", ":car:.xodr")
    console().print(table)
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("[bold]x.xodr", "[/red].xodr", ":car:.xodr"))


def test_score_that_only_one_case_study_has_is_shown_beside_a_gap(capsys: pytest.CaptureFixture[str]) -> None:
    arrived = {"case_study": "roundabout", "success_rate": 1.0, "success_seconds": 41.5}
    crashed = {"case_study": "unprotected-left", "success_rate": 0.0}
    print_scores("town03", [crashed, arrived], as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert next(line.split() for line in lines if "success_seconds" in line)[-2:] == ["41.5", "│"]
