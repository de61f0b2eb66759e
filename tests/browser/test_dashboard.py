"""The run's page as a browser shows it: TensorBoard draws the layout that comes with the event files."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from athrl_evaluator.dashboard import LAYOUT, with_interval
from athrl_evaluator.event_files import EventFiles
from PIL import Image

from tests.browser.chromium import Page

WAIT_SECONDS = 240.0
CURVE = (255, 112, 67)
"""TensorBoard's colour of the first run."""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture
def address(free_port: Callable[[], int], tmp_path: Path) -> Iterator[str]:
    """The address of a TensorBoard with the curves of a run."""
    files = EventFiles(tmp_path / "runs/town03/tensorboard")
    for step in range(20):
        files.add("learner/learner", {"environment_steps_per_second": 200.0 + step}, step, 1.0)
        scores = {"return_mean": 10.0 * step, "return_ci95": 20.0}
        files.add("evaluation/policy", with_interval(scores), step, 1.0)
    port = free_port()
    program = Path(sys.executable).with_name("tensorboard")
    with subprocess.Popen(
        [program, "--logdir", tmp_path / "runs", "--port", str(port), "--load_fast", "false"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        assert any(f"http://localhost:{port}/" in line for line in process.stderr)
        yield f"http://127.0.0.1:{port}/#custom_scalars"
        process.terminate()


def test_page_of_the_run_has_its_charts_and_curves(page: Page, address: str, tmp_path: Path) -> None:
    page.open(address)
    deadline = time.monotonic() + WAIT_SECONDS
    while True:
        text, picture = page.text(), page.picture()
        (tmp_path / "page.png").write_bytes(picture)
        pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
        curves = (np.abs(pixels - CURVE).max(axis=2) < 12).sum()
        if all(title in text for title in (*LAYOUT, *LAYOUT["Progress"])) and curves > 100:
            return
        assert time.monotonic() < deadline, f"{curves} pixels of curves in {tmp_path / 'page.png'}; {text}"
        time.sleep(1)
