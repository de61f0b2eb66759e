"""Size limits of messages, so that no message can fill the memory of a service.

Zenoh drops larger messages before a service sees them: at a client by `max_message_size`, at the learner also
by limits of each key. It does so silently. `ChunkIntake` has a lower limit for chunks, and answers that a
chunk is too large for its run.
"""

from __future__ import annotations

from athrl_spaces.policy import LARGEST_STATE

KIBIBYTE = 2**10
MEBIBYTE = 2**20
LARGEST_POLICY = 512 * MEBIBYTE
"""Limit of a client; a policy is the largest message that it receives."""
LARGEST_CHUNK = 80 * MEBIBYTE
"""Limit of the learner: 64 MiB of images that cannot be compressed, and columns."""
LARGEST_NUMBERS = 256 * KIBIBYTE
"""Metrics or scores of one service."""
MOST_CHANNELS = 16
"""Limit for the channels of an image of any planner; currently four."""
LARGEST_STATES = 4 * LARGEST_STATE
"""Bytes of the recurrent states of all levels together before one step, for any planner."""
LARGEST_FRAME = 4 * MEBIBYTE
LARGEST_QUESTION = 4 * KIBIBYTE
"""A query for a value, which has no content."""
