"""A hint names a program so that it can be copied into the terminal."""

import os
import sys
from pathlib import Path

import pytest
from athrl.service_names import program


def test_a_program_that_is_not_on_the_path_is_named_with_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent))
    assert program("athrl") == "athrl"
    monkeypatch.setenv("PATH", "")
    assert os.access(program("athrl"), os.X_OK)


def test_a_program_elsewhere_is_named_by_its_whole_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.chdir(tmp_path)
    assert Path(program("athrl")).is_absolute()
    monkeypatch.chdir(Path(sys.executable).parents[1])
    assert program("athrl") == "bin/athrl"
