"""A real browser for the tests of this folder."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.browser.chromium import PROGRAM, Page, chromium


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """An empty page of a browser without a window."""
    if PROGRAM is None:
        pytest.skip("no Chromium is installed here: apt-get install chromium")
    with chromium(tmp_path / "profile") as page:
        yield page
