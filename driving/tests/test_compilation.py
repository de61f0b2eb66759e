"""Machine code is kept where it can be written, and never taken for that of other sources."""

from pathlib import Path

import pytest
from athrl_driving import compilation


def folder() -> str:
    return compilation.cache_folder.__wrapped__()


def test_the_users_choice_of_folder_is_respected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert Path(folder()).parent == tmp_path / "chosen"


def test_a_folder_that_cannot_be_written_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_folder = tmp_path / "file"
    no_folder.touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(no_folder))
    monkeypatch.setattr(compilation, "_PACKAGE", no_folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert Path(folder()).parent == tmp_path / "home"
    monkeypatch.setenv("XDG_CACHE_HOME", str(no_folder))
    assert Path(folder()).is_dir()


def test_changed_kernels_get_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    (tmp_path / "traffic").mkdir()
    source = tmp_path / "traffic" / "tick.py"
    source.write_text("one")
    before = folder()
    source.write_text("two")
    assert folder() != before
