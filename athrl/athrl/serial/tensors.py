"""Converts nested states of arrays to tensors, which a checkpoint writes and reads without pickle."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch


def to_tensors(state: Any) -> Any:
    """The same dictionaries and lists, with copies of the arrays as tensors and bytes as uint8 tensors."""
    if isinstance(state, bytes):
        return torch.frombuffer(bytearray(state), dtype=torch.uint8)
    if isinstance(state, np.ndarray):
        return torch.from_numpy(np.array(state))
    if isinstance(state, dict):
        return {name: to_tensors(value) for name, value in state.items()}
    if isinstance(state, list):
        return [to_tensors(value) for value in state]
    return state


def to_arrays(state: Any) -> Any:
    """The same dictionaries and lists, with tensors as arrays."""
    if isinstance(state, torch.Tensor):
        return state.numpy()
    if isinstance(state, dict):
        return {name: to_arrays(value) for name, value in state.items()}
    if isinstance(state, list):
        return [to_arrays(value) for value in state]
    return state
