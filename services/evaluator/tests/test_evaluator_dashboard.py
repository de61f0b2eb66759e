"""A real TensorBoard shows the run's page: its charts have curves, and the newest recordings are named."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import urlopen

import pytest
from athrl_evaluator.dashboard import LAYOUT, with_interval
from athrl_evaluator.event_files import EventFiles

SCORES = {"return_mean": 10.0, "return_ci95": 2.0, "collision_rate": 0.25, "driving_score": 0.5}
METRICS = {
    "learner/learner": [
        "environment_steps_per_second", "updates_per_second", "actors", "waiting/learner",
        "policy_lag_seconds", "loss/intention/td_error", "loss/intention/value",
    ],
    "actor/actor-1": ["decisions_per_second", "return_mean", "collision_rate"],
}  # fmt: skip


@pytest.fixture(scope="module")
def tensorboard(
    tmp_path_factory: pytest.TempPathFactory, free_port: Callable[[], int]
) -> Iterator[Callable[[str], Any]]:
    """Asks a TensorBoard that reads a run's folder."""
    folder = tmp_path_factory.mktemp("runs") / "town03"
    (folder / "recordings").mkdir(parents=True)
    for number in range(7):
        (folder / "recordings" / f"policy-{number}.mcap").touch()
        time.sleep(0.01)
    files = EventFiles(folder / "tensorboard")
    for prefix, names in METRICS.items():
        files.add(prefix, dict.fromkeys(names, 0.5), 100, 1.0)
    files.add("evaluation/policy", with_interval(SCORES), 100, 1.0)
    files.add_links(folder / "recordings", 100, 1.0)
    port = free_port()
    program = Path(sys.executable).with_name("tensorboard")
    with subprocess.Popen(
        [program, "--logdir", folder.parent, "--port", str(port), "--load_fast", "false"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            yield lambda path: ask(port, path)
        finally:
            process.terminate()
            process.wait(30)


def ask(port: int, path: str) -> Any:
    """TensorBoard's answer, once it has one that is not empty."""
    deadline = time.monotonic() + 150
    while True:
        try:
            with urlopen(f"http://127.0.0.1:{port}/data/{path}", timeout=60) as answer:
                if found := json.load(answer):
                    return found
        except URLError:
            pass
        assert time.monotonic() < deadline, path
        time.sleep(0.2)


def test_page_has_the_charts_of_the_run(tensorboard: Callable[[str], Any]) -> None:
    shown = tensorboard("plugin/custom_scalars/layout")
    assert {each["title"]: [chart["title"] for chart in each["chart"]] for each in shown["category"]} == {
        title: list(charts) for title, charts in LAYOUT.items()
    }


def test_each_chart_has_a_curve(tensorboard: Callable[[str], Any]) -> None:
    shown = tensorboard("plugin/custom_scalars/layout")
    (run,) = tensorboard("runs")
    for chart in (chart for each in shown["category"] for chart in each["chart"]):
        for tag in chart.get("multiline", {}).get("tag", []):
            found = tensorboard(f"plugin/custom_scalars/scalars?run={quote(run)}&tag={quote(tag)}")
            assert found["regex_valid"]
            assert found["tag_to_events"], f"{chart['title']}: no curve matches {tag}"


def test_return_has_the_band_of_its_interval(tensorboard: Callable[[str], Any]) -> None:
    shown = tensorboard("plugin/custom_scalars/layout")
    (band,) = [
        series for each in shown["category"] for chart in each["chart"]
        for series in chart.get("margin", {}).get("series", [])
    ]  # fmt: skip
    (run,) = tensorboard("runs")
    values = [
        tensorboard(f"plugin/scalars/scalars?run={quote(run)}&tag={quote(band[end])}")[-1][2]
        for end in ("lower", "value", "upper")
    ]
    assert values == [8.0, 10.0, 12.0]


def test_text_leads_to_the_live_episode_and_the_newest_recordings(tensorboard: Callable[[str], Any]) -> None:
    (run,) = tensorboard("runs")
    (newest,) = tensorboard(f"plugin/text/text?run={quote(run)}&tag={quote('run/where to look')}")
    assert 'href="http://127.0.0.1:9890/?url=' in newest["text"]
    named = re.findall(r"policy-(\d)\.mcap", newest["text"])
    assert named == ["6", "5", "4", "3", "2"]
