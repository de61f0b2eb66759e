"""What makes a chunk valid: the checks refuse what their plain counterparts refuse, and nothing else."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from athrl_protocol import Chunk, InvalidMessage, LevelColumns, check_chunk
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays

COLUMNS = ["motion"] + [
    f"{level}.{column}"
    for level in ("intention", "trajectory")
    for column in ("actions", "rewards", "states")
]
_quick = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
_anything = some.floats(width=32, allow_nan=True, allow_infinity=True)
_largest = float(np.finfo(np.float32).max)


def _refusal(chunk: Chunk) -> str | None:
    try:
        check_chunk(dataclasses.replace(chunk, actor="a"))
    except InvalidMessage as error:
        return str(error)
    return None


def _with(chunk: Chunk, name: str, values: np.ndarray) -> Chunk:
    level, _, column = name.rpartition(".")
    if not level:
        return dataclasses.replace(chunk, **{column: values})
    levels = chunk.levels | {level: dataclasses.replace(chunk.levels[level], **{column: values})}
    return dataclasses.replace(chunk, levels=levels)


def _column(chunk: Chunk, name: str) -> np.ndarray:
    level, _, column = name.rpartition(".")
    return getattr(chunk.levels[level] if level else chunk, column)


@_quick
@given(some.data())
def test_exactly_numbers_that_are_not_finite_are_refused(
    make_chunk: Callable[..., Chunk], data: some.DataObject
) -> None:
    chunk = make_chunk()
    for name in data.draw(some.lists(some.sampled_from(COLUMNS), max_size=3, unique=True)):
        shape = _column(chunk, name).shape
        chunk = _with(chunk, name, data.draw(arrays.arrays(np.float32, shape, elements=_anything)))
    wrong = [name for name in COLUMNS if not all(map(np.isfinite, _column(chunk, name).ravel()))]
    refusal = _refusal(chunk)
    assert refusal == (f"chunk: {wrong[0]} has numbers that are not finite" if wrong else None)


@pytest.mark.parametrize("value", [_largest, -_largest, float(np.finfo(np.float32).smallest_subnormal), -0.0])
def test_extreme_numbers_are_taken(make_chunk: Callable[..., Chunk], value: float) -> None:
    chunk = make_chunk()
    for name in COLUMNS:
        chunk = _with(chunk, name, np.full_like(_column(chunk, name), value))
    assert _refusal(chunk) is None


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, -1])
def test_one_number_among_many_is_found(
    make_chunk: Callable[..., Chunk], name: str, value: float, place: int
) -> None:
    chunk = make_chunk(time=1_024)
    values = _column(chunk, name).copy()
    values.flat[place] = value
    assert _refusal(_with(chunk, name, values)) == f"chunk: {name} has numbers that are not finite"


@_quick
@given(some.data(), some.integers(1, 40))
def test_exactly_negative_policy_versions_are_refused(
    make_chunk: Callable[..., Chunk], data: some.DataObject, time: int
) -> None:
    versions = data.draw(arrays.arrays(np.int64, time))
    refusal = _refusal(dataclasses.replace(make_chunk(time=time), policy_version=versions))
    assert refusal == ("chunk: policy_version has negative numbers" if min(versions) < 0 else None)


@_quick
@given(some.sampled_from(["images", "motion", *COLUMNS[1:]]), some.data())
def test_exactly_other_shapes_are_refused(
    make_chunk: Callable[..., Chunk], name: str, data: some.DataObject
) -> None:
    chunk = make_chunk(time=2)
    first = {"images": 3, "motion": 3, "states": 1}.get(name.rpartition(".")[2], 2)
    dimensions = _column(chunk, name).ndim
    shape = tuple(data.draw(some.lists(some.integers(0, 3), max_size=5) | some.just([first] * dimensions)))
    fits = len(shape) == dimensions and shape[0] == first
    fits = fits and (name.endswith("states") or min(shape) > 0)
    changed = _with(chunk, name, np.zeros(shape, _column(chunk, name).dtype))
    refusal = _refusal(changed)
    if fits:
        assert refusal is None
    else:
        wanted = ", ".join([str(first)] + ["any"] * (dimensions - 1))
        assert refusal == f"chunk: {name} has shape {list(shape)}, should be [{wanted}]"


@pytest.mark.parametrize("name", ["images", "policy_version", *COLUMNS])
@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.dtype(">f4"), np.dtype(">i8"), np.bool_])
def test_other_types_are_refused(make_chunk: Callable[..., Chunk], name: str, dtype: np.dtype) -> None:
    chunk = make_chunk()
    refusal = _refusal(_with(chunk, name, _column(chunk, name).astype(dtype)))
    assert refusal is not None
    assert refusal.startswith(f"chunk: {name} is ")


def test_states_may_be_empty(make_chunk: Callable[..., Chunk]) -> None:
    chunk = make_chunk()
    level = chunk.levels["intention"]
    empty = LevelColumns(level.actions, level.rewards, np.zeros((1, 0), np.float32))
    assert _refusal(dataclasses.replace(chunk, levels={"intention": empty})) is None
