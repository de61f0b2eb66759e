"""A viewer survives frames that anybody may send, or write into a file, and does no work for them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rerun as rr
from athrl_evaluator.drawing import scene
from athrl_evaluator.drawing.scene import MOST_CURVES, MOST_TOWNS, SceneDrawing
from athrl_protocol import Frame


@pytest.fixture
def stream() -> Iterator[rr.RecordingStream]:
    stream = rr.RecordingStream("test")
    stream.memory_recording()
    yield stream
    stream.disconnect()


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Towns whose roads were looked up; those that begin with "no" cannot be loaded."""
    names: list[str] = []
    original = scene.lane_polylines

    def look(town: str) -> list:
        names.append(town)
        return original("nowhere.xodr" if town.startswith("no") else "town03")

    monkeypatch.setattr(scene, "lane_polylines", look)
    return names


def frame(step: int, town: str = "town03", time: float | None = None, **decision: float) -> Frame:
    vehicle = {"x": 10.0, "y": 20.0, "heading": 0.3, "speed": 5.0, "length": 4.9, "width": 2.1}
    return Frame(
        driver="policy", town=town, step=step, time=0.4 * step if time is None else time, ego=vehicle,
        decision=decision,
    )  # fmt: skip


def test_only_towns_of_the_run_are_loaded(stream: rr.RecordingStream, loaded: list[str]) -> None:
    drawing = SceneDrawing(stream, towns={"town03"})
    for step, town in enumerate(("town03", "/etc/anything.xodr", "random-1", "town03")):
        drawing.draw(frame(step, town))
    assert loaded == ["town03"]


def test_town_that_cannot_be_loaded_is_drawn_without_roads(
    stream: rr.RecordingStream, loaded: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    drawing = SceneDrawing(stream)
    for step, town in enumerate(("no-such", "town03", "no-such", "town03")):
        drawing.draw(frame(step, town))
    assert loaded == ["no-such", "town03"]
    assert "the roads of no-such are not drawn" in caplog.text


def test_a_file_with_ever_new_towns_loads_few_of_them(stream: rr.RecordingStream, loaded: list[str]) -> None:
    drawing = SceneDrawing(stream)
    for step in range(3 * MOST_TOWNS):
        drawing.draw(frame(step, f"random-{step}"))
    assert len(loaded) == MOST_TOWNS


def test_ever_new_names_of_decisions_make_the_layout_no_longer(
    stream: rr.RecordingStream, loaded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    layouts: list[int] = []
    original = scene.make_blueprint

    def counted(names: list[str]) -> object:
        layouts.append(len(names))
        return original(names)

    monkeypatch.setattr(scene, "make_blueprint", counted)
    drawing = SceneDrawing(stream)
    for step in range(100):
        drawing.draw(frame(step, **{f"decided {step}": 1.0}))
    assert len(layouts) == max(layouts) == MOST_CURVES


def test_times_that_jump_never_leave_what_rerun_can_count(
    stream: rr.RecordingStream, loaded: list[str]
) -> None:
    drawing = SceneDrawing(stream)
    for step in range(400):
        drawing.draw(frame(step, time=1e8 if step % 2 == 0 else 0.0))
