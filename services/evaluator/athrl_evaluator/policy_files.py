"""Policy files, held against what their learner wrote down beside them."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from athrl_driving.policy import InvalidPolicy, OnnxPolicy

PUBLISHING_SECONDS = 1.0  # a learner that publishes just now replaces first the one file, then the other
PAUSE_SECONDS = 0.1


def load_policy(path: Path) -> OnnxPolicy:
    """Read a policy file; one that has its facts beside it, as `latest.json`, only if its SHA-256 is theirs.

    Raises:
        InvalidPolicy: it is no policy, or not the one that the facts are of.
    """
    _require_told(path)
    return OnnxPolicy.load(path)


def _require_told(path: Path) -> None:
    until = time.monotonic() + PUBLISHING_SECONDS
    while (told := _told_beside(path)) is not None:
        found = _sha256_of(path)
        if found in (None, told):
            return
        if time.monotonic() > until:
            raise InvalidPolicy(
                f"{path} is not the policy of which {_facts_of(path).name} beside it tells: its SHA-256 is "
                f"{found}, it should be {told}; give the file as its learner wrote it"
            )
        time.sleep(PAUSE_SECONDS)


def _told_beside(path: Path) -> str | None:
    """The SHA-256 in the file of facts; None where there is no such file, or one that tells none."""
    try:
        told = json.loads(_facts_of(path).read_bytes())["sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return told.lower() if isinstance(told, str) else None


def _sha256_of(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:  # whoever loads it says why
        return None


def _facts_of(path: Path) -> Path:
    return path.with_suffix(".json")
