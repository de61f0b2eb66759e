"""How large a message may be, so that nobody can fill the memory of a service with one.

Zenoh drops what is larger before a service sees it: a client by `max_message_size`, the learner in addition
by what the key is for. It does so in silence; `ChunkIntake` refuses a chunk that is too large for its run,
and says so, well before that.
"""

from __future__ import annotations

from typing import Any

from athrl_spaces.policy import LARGEST_STATE

from athrl_protocol.keys import Keys
from athrl_protocol.run_file import RunFile

KIBIBYTE = 2**10
MEBIBYTE = 2**20
LARGEST_POLICY = 512 * MEBIBYTE
"""What a client takes at most; a policy is the largest thing it is sent."""
LARGEST_CHUNK = 80 * MEBIBYTE
"""What the learner takes at most: 64 MiB of images that cannot be compressed, and columns."""
LARGEST_NUMBERS = 256 * KIBIBYTE
"""Metrics or scores of one service."""
MOST_CHANNELS = 16
"""Of an image, whatever the planner perceives; four today."""
LARGEST_STATES = 4 * LARGEST_STATE
"""Bytes of the recurrent states of all levels together before one step, whatever the planner."""
LARGEST_FRAME = 4 * MEBIBYTE
LARGEST_QUESTION = 4 * KIBIBYTE
"""A query that asks for a value; it has no content."""


def largest_chunk_of(run_file: RunFile) -> int:
    """Return bytes that no chunk of a run exceeds, with some to spare."""
    sequences = run_file.longest_chunk // run_file.replay.sequence_length
    pixels = (run_file.longest_chunk + 1) * run_file.environment.image_size**2
    states = LARGEST_STATES * sequences
    return min(LARGEST_CHUNK, pixels * MOST_CHANNELS + states + 256 * KIBIBYTE)


def largest_message(largest_chunk: int) -> int:
    """Return bytes of the largest message that Zenoh puts together for the learner, of whatever kind.

    A chunk that is somewhat larger than `largest_chunk` is let in, so that it can be refused by name.
    """
    return max(4 * largest_chunk, LARGEST_FRAME) + 64 * KIBIBYTE


def size_filter(run: str, largest_chunk: int) -> list[dict[str, Any]]:
    """Return Zenoh's `low_pass_filter` for the learner of a run.

    Args:
        run: name of the run.
        largest_chunk: bytes of a chunk's message.
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
            ["athrl/*/run-file", keys.policy, keys.state, keys.every_evaluation],
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
