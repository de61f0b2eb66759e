"""The state of a PCG64 generator as integers below 2^64, since some JSON readers do not accept 128 bits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

_WORD = 2**64


def to_words(random: np.random.Generator) -> list[int]:
    """The generator's state as six integers."""
    state = random.bit_generator.state
    value, increment = state["state"]["state"], state["state"]["inc"]
    words = [*divmod(value, _WORD), *divmod(increment, _WORD), state["has_uint32"], state["uinteger"]]
    return [int(word) for word in words]


def restore_random(random: np.random.Generator, words: Iterable[int]) -> None:
    """Restore a PCG64 generator from what `to_words` returned; raises ValueError for anything else."""
    numbers = [int(word) for word in words]
    if len(numbers) != 6:
        raise ValueError(f"the generator's state has {len(numbers)} numbers; it should have 6")
    random.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": numbers[0] * _WORD + numbers[1], "inc": numbers[2] * _WORD + numbers[3]},
        "has_uint32": numbers[4],
        "uinteger": numbers[5],
    }
