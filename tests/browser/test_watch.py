"""`athrl watch --browser`: somebody who has a browser alone sees the town move."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from athrl_evaluator.drawing.colours import EGO
from numpy.typing import NDArray
from PIL import Image

from tests.browser.chromium import Page

WAIT_SECONDS = 400.0  # with a compilation, and a picture that is computed without a GPU
SECONDS_BETWEEN = 1.0
ROWS, COLUMNS = slice(0, 440), slice(540, 850)
"""Pixels of the page with the whole town; in the view around the car the car stays where it is."""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture
def address(free_port: Callable[[], int], tmp_path: Path) -> Iterator[str]:
    """The address of the page that a driver's episodes are shown on."""
    options = ["--policy", "rule-based", "--browser", "--page", str(free_port()), "--serve", str(free_port())]
    said = tmp_path / "said"
    with said.open("w") as log:
        process = subprocess.Popen([sys.executable, "-m", "athrl", "watch", *options], stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + WAIT_SECONDS
        while "watching rule-based: " not in said.read_text():
            assert process.poll() is None, said.read_text()
            assert time.monotonic() < deadline
            time.sleep(0.2)
        yield said.read_text().split("watching rule-based: ")[1].split()[0]
    finally:
        process.terminate()
        assert process.wait(60) == 0, said.read_text()


def test_town_moves_in_a_browser(page: Page, address: str, tmp_path: Path) -> None:
    page.open(address)
    first = await_car(page, None, tmp_path / "first.png")
    await_car(page, first, tmp_path / "second.png")


def await_car(page: Page, before: NDArray[np.bool_] | None, file: Path) -> NDArray[np.bool_]:
    """Wait for a picture in which the driven car is elsewhere than `before`; return where.

    Returns:
        bool [height, width], where the view of the town has the colour of that car.
    """
    deadline = time.monotonic() + WAIT_SECONDS
    while True:
        picture = page.picture()
        file.write_bytes(picture)
        pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
        car = np.abs(pixels[ROWS, COLUMNS] - EGO).max(axis=2) < 12
        if car.any() and (before is None or (car != before).any()):
            return car
        assert time.monotonic() < deadline, f"no car, or none that moves, in {file}"
        time.sleep(SECONDS_BETWEEN)
