"""Tests of the names of a package that are imported when they are first used."""

import importlib
import sys
from pathlib import Path

import pytest


def test_a_name_is_imported_on_first_use_and_no_other_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "lazy_package"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from athrl_spaces.first_use import on_first_use\n"
        "__getattr__ = on_first_use(__name__, {'answer': 'heavy'})\n"
    )
    (package / "heavy.py").write_text("answer = 42\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    lazy_package = importlib.import_module("lazy_package")
    try:
        assert "lazy_package.heavy" not in sys.modules
        assert lazy_package.answer == 42
        with pytest.raises(AttributeError, match="module 'lazy_package' has no attribute 'other'"):
            _ = lazy_package.other
    finally:
        for name in ("lazy_package", "lazy_package.heavy"):
            sys.modules.pop(name, None)
