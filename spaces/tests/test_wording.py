"""Messages of all rooms say the same thing in the same words."""

from __future__ import annotations

import errno
import os
import socket

import pytest
from athrl_spaces.wording import counted, system_reason


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), "no space left on device"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "A/File"), "no such file or directory"),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "name or service not known"),
        (TimeoutError("timed out"), "timed out"),
        (OSError("decoder of A/File is missing"), "decoder of A/File is missing"),
        (BrokenPipeError(), "BrokenPipeError"),
    ],
    ids=["disk", "path", "name", "library", "names-stay", "no-text"],
)
def test_reason_is_the_words_of_the_system_or_else_of_who_raised_it(error: OSError, reason: str) -> None:
    assert system_reason(error) == reason


def test_one_thing_is_no_plural() -> None:
    assert [counted(number, "episode") for number in (0, 1, 2, 2_000)] == [
        "0 episodes",
        "1 episode",
        "2 episodes",
        "2,000 episodes",
    ]
