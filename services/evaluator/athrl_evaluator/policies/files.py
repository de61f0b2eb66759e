"""Policy files, verified against the JSON file that their learner wrote beside them."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

from athrl_driving.policy import LARGEST_ARTEFACT, InvalidPolicy, OnnxPolicy
from athrl_spaces.untrusted import PARSER_ERRORS, UntrustedFile, read_json, read_untrusted

PUBLISHING_SECONDS = 1.0  # a learner that is publishing replaces one file after the other
PAUSE_SECONDS = 0.1


def load_policy(path: Path) -> OnnxPolicy:
    """Read a policy file; if a JSON file such as `latest.json` is beside it, the SHA-256 in it must match.

    Raises:
        InvalidPolicy: it is no policy, or not the one that the JSON file describes.
    """
    _require_recorded_sha256(path)
    return OnnxPolicy.load(path)


def _require_recorded_sha256(path: Path) -> None:
    until = time.monotonic() + PUBLISHING_SECONDS
    while (recorded := _recorded_sha256(path)) is not None:
        found = _sha256_of(path)
        if found in (None, recorded):
            return
        if time.monotonic() > until:
            raise InvalidPolicy(
                f"{path} is not the policy that {_facts_of(path).name} beside it describes: its SHA-256 is "
                f"{found}, it should be {recorded}; give the file as its learner wrote it"
            )
        time.sleep(PAUSE_SECONDS)


def _recorded_sha256(path: Path) -> str | None:
    """The SHA-256 in the JSON file; None if there is no such file or it contains none."""
    try:
        recorded = read_json(_facts_of(path))["sha256"]
    except PARSER_ERRORS:
        return None
    return recorded.lower() if isinstance(recorded, str) else None


def _sha256_of(path: Path) -> str | None:
    try:
        return hashlib.sha256(read_untrusted(path, LARGEST_ARTEFACT)).hexdigest()
    except UntrustedFile:  # loading it reports the reason
        return None


def _facts_of(path: Path) -> Path:
    return path.with_suffix(".json")
