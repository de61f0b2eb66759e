"""A short hash of a state, for comparing two runs: equal if every bit is equal."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from athrl_planners import Agent, SequenceReplay

#: Hexadecimal digits that are shown of a SHA-256.
DIGITS = 16


def fingerprint(state: Any) -> str:
    """The first digits of a SHA-256 over nested dictionaries, lists, arrays, tensors and plain values.

    Dictionaries are hashed in the order of their keys, arrays with type and shape.

    Raises:
        TypeError: the state contains another type.
    """
    checksum = hashlib.sha256()
    _add(checksum, state)
    return checksum.hexdigest()[:DIGITS]


def parameters(agent: Agent) -> str:
    """Fingerprint of all weights of the planner: online, target and averaged."""
    return fingerprint(agent.state_dict()["networks"])


def optimisers(agent: Agent) -> str:
    """Fingerprint of the rest of the planner's state: optimisers, generators, counts."""
    return fingerprint({name: part for name, part in agent.state_dict().items() if name != "networks"})


def replay_content(replay: SequenceReplay) -> str:
    """Fingerprint of the replay: sequences by slot, counts, generator and priorities."""
    return fingerprint([replay.columns(), replay.state(), replay.priorities()])


def _add(checksum: Any, value: Any) -> None:
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        checksum.update(f"array {value.dtype.str} {value.shape};".encode())
        checksum.update(np.ascontiguousarray(value).data)
    elif isinstance(value, Mapping):
        checksum.update(f"mapping {len(value)};".encode())
        for key in sorted(value, key=str):
            checksum.update(f"{key}=".encode())
            _add(checksum, value[key])
    elif isinstance(value, list | tuple):
        checksum.update(f"list {len(value)};".encode())
        for item in value:
            _add(checksum, item)
    elif value is None or isinstance(value, bool | int | float | str):
        checksum.update(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(f"cannot make a fingerprint of a {type(value).__name__}")
