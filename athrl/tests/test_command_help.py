"""The help is for people with a screen, and a shell completes what they type."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from athrl.command import SUBCOMMANDS

SCREEN = 32


def athrl(*words: str, **environment: str) -> str:
    """Run the command and return what it printed."""
    result = subprocess.run(
        [sys.executable, "-m", "athrl", *words],
        env={**os.environ, "COLUMNS": "80", **environment}, capture_output=True, text=True, check=False,
        timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_help_names_every_subcommand_and_fits_a_screen() -> None:
    lines = athrl("--help").splitlines()
    assert len(lines) <= SCREEN
    named = {line.split()[1] for line in lines if line.startswith("│")}
    assert set(SUBCOMMANDS) <= named


def test_help_of_train_is_in_groups() -> None:
    text = athrl("train", "--help")
    assert all(panel in text for panel in ("What to run", "Machine and network", "Serial runs"))


@pytest.mark.parametrize(
    ("typed", "completed"),
    [("athrl tr", "train"), ("athrl train --resu", "--resume"), ("athrl poli", "policies")],
)
def test_shell_completes_subcommands_and_options(typed: str, completed: str) -> None:
    place = str(len(typed.split()) - 1)
    shown = athrl(_ATHRL_COMPLETE="complete_bash", COMP_WORDS=typed, COMP_CWORD=place)
    assert completed in shown.split()
