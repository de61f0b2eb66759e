"""The form of a checkpoint's parts, checked when they are read: types, ranges, and how much they may hold."""

from __future__ import annotations

import json
import zipfile
from pickle import UnpicklingError
from typing import Annotated, Any, BinaryIO

import torch
from athrl_spaces.untrusted import one_short_line
from pydantic import BaseModel, ConfigDict, Field, ValidationError

MOST_VALUES = 100_000
"""Tensors and plain values in the state of a planner or an actor, each time that it is reached."""
MOST_DEPTH = 64
"""Dictionaries and lists one in the other."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
_Word = Annotated[int, Field(ge=0, lt=2**64)]


class _Form(BaseModel):
    """What a dictionary should have; it may have more."""

    model_config = ConfigDict(strict=True)


class _Limiter(_Form):
    inserts: Count
    samples: Count
    forgiven: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0


class _Replay(_Form):
    inserted: Count
    sequences: Count
    random: list[_Word]


class _State(_Form):
    run_file: dict[str, dict[str, Any]]
    environment_steps: Count
    updates: Count
    policy_version: Annotated[int, Field(ge=-1, lt=2**63)]
    limiter: _Limiter
    ledger: dict[str, dict[str, _Word]]
    totals: dict[str, Count]
    damaged: Count = 0
    replay: _Replay
    policy: str


class _Agent(_Form):
    planner: dict[str, Any]
    priorities: dict[str, Any]


def read_state(content: bytes) -> dict[str, Any]:
    """Return the learner's state from its JSON.

    Raises:
        ValueError, RecursionError: it is none, or lacks a part, or a part has another type or range.
    """
    state: dict[str, Any] = json.loads(content)
    _require_form(_State, state)
    return state


def read_tensors(file: BinaryIO) -> dict[str, Any]:
    """Return nested dictionaries and lists of tensors and plain values, on the CPU; unpickles nothing else.

    Raises:
        ValueError, zipfile.BadZipFile: the file is no archive without compression, or announces more than it
            holds.
        Exception: what torch raises for a damaged archive.
    """
    _require_plain_archive(file)
    try:
        loaded = torch.load(file, map_location="cpu", weights_only=True)
    except UnpicklingError:  # whose text tells how to load it all the same
        raise ValueError("holds something besides tensors and plain values") from None
    if not isinstance(loaded, dict):
        raise ValueError(f"holds a {type(loaded).__name__}, should hold a dictionary")
    _require_small(loaded)
    return loaded


def require_agent(values: dict[str, Any]) -> None:
    """Raise ValueError unless these are the states of a planner and of the priorities."""
    _require_form(_Agent, values)


def _require_form(form: type[_Form], values: Any) -> None:
    try:
        form.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "its content"
        raise ValueError(one_short_line(f"{place}: {first['msg']}")) from None


def _require_plain_archive(file: BinaryIO) -> None:
    """Refuse compressed entries, and entries that overlap: both unpack to more than the file holds."""
    size = file.seek(0, 2)
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
    file.seek(0)
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise ValueError("has compressed entries, which no learner writes")
    if sum(entry.file_size for entry in entries) > size:
        raise ValueError(f"announces more data than its {size:,} bytes")


def _require_small(values: dict[str, Any]) -> None:
    """Refuse a structure that is large because parts of it occur often, or a tensor that repeats its data."""
    waiting: list[tuple[Any, int]] = [(values, 1)]
    count = 0
    while waiting:
        value, depth = waiting.pop()
        count += 1
        if count > MOST_VALUES or depth > MOST_DEPTH:
            raise ValueError(f"holds more than {MOST_VALUES:,} values or {MOST_DEPTH} levels of them")
        if isinstance(value, dict):
            waiting += [(inner, depth + 1) for inner in value.values()]
        elif isinstance(value, list | tuple | set):
            waiting += [(inner, depth + 1) for inner in value]
        elif isinstance(value, torch.Tensor):
            _require_own_data(value)


def _require_own_data(tensor: torch.Tensor) -> None:
    if tensor.layout != torch.strided or tensor.device.type != "cpu":
        raise ValueError(f"has a tensor of layout {tensor.layout} on {tensor.device}, should be a plain one")
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise ValueError(f"has a tensor of shape {tuple(tensor.shape)} that repeats its data")
