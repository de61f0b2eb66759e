"""Size limits in Zenoh, which drops larger messages before a service sees them.

A client has `max_message_size`, the learner also a limit for each kind of key. Zenoh drops messages silently.
`ChunkIntake` has a lower limit for chunks, and answers that a chunk is too large for its run.
"""

from __future__ import annotations

from typing import Any

from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.limits import (
    KIBIBYTE,
    LARGEST_CHUNK,
    LARGEST_FRAME,
    LARGEST_NUMBERS,
    LARGEST_QUESTION,
    LARGEST_STATES,
    MOST_CHANNELS,
)
from athrl_protocol.run_file import RunFile


def largest_chunk_of(run_file: RunFile) -> int:
    """Return an upper bound for the bytes of a chunk of this run."""
    sequences = run_file.longest_chunk // run_file.replay.sequence_length
    pixels = (run_file.longest_chunk + 1) * run_file.environment.image_size**2
    states = LARGEST_STATES * sequences
    return min(LARGEST_CHUNK, pixels * MOST_CHANNELS + states + 256 * KIBIBYTE)


def largest_message(largest_chunk: int) -> int:
    """Return bytes of the largest message of any kind that Zenoh assembles for the learner.

    A chunk slightly larger than `largest_chunk` is let through, so that it can be refused with an answer.
    """
    return max(4 * largest_chunk, LARGEST_FRAME) + 64 * KIBIBYTE


def size_filter(run: str, largest_chunk: int) -> list[dict[str, Any]]:
    """Return Zenoh's `low_pass_filter` for the learner of a run.

    Args:
        run: name of the run.
        largest_chunk: most bytes of a chunk's message.
    """
    keys = Keys(run)
    return [
        _largest("experience", largest_message(largest_chunk), ["query", "put"], [keys.every_experience]),
        _largest("numbers", LARGEST_NUMBERS, ["put", "reply"], [keys.every_metrics, keys.every_evaluation]),
        _largest("frames", LARGEST_FRAME, ["put"], [keys.every_live]),
        _largest(
            "questions",
            LARGEST_QUESTION,
            ["query"],
            [
                "athrl/*/run-file",
                keys.changes,
                keys.free_name("actor"),
                keys.policy,
                keys.state,
                keys.every_evaluation,
            ],
        ),
    ]


def _largest(name: str, limit: int, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "flows": ["ingress"],
        "messages": messages,
        "key_exprs": keys,
        "size_limit": limit,
    }
