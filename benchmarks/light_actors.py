"""Actors that only send, as processes of their own, for benchmarks of the learner's side."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from athrl_learner.intake.store import ExperienceStore

from benchmarks.light_actor import STEPS

_PATIENCE = 60.0
_FILLED_WITHIN = 240.0


@contextlib.contextmanager
def light_actors(
    addresses: Sequence[str], steps: int = STEPS, within: Sequence[Sequence[str]] = ()
) -> Iterator[list[dict[str, Any]]]:
    """Run a light actor for each address; their reports are in the list afterwards.

    Each sends chunks of `steps` decisions. `within` has for each the words before its command that make it
    run elsewhere, in another network namespace.
    """
    program = [sys.executable, "-m", "benchmarks.light_actor"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    actors = [
        subprocess.Popen([*before, *program, address, f"actor-{number}", str(steps)], **pipes)
        for number, (address, before) in enumerate(
            zip(addresses, within or [()] * len(addresses), strict=True)
        )
    ]
    try:
        if not all(actor.stdout.readline() == b"ready\n" for actor in actors):
            sys.exit("an actor could not be started: see the error above")
        reports: list[dict[str, Any]] = []
        yield reports
        for actor in actors:
            actor.stdin.close()
        reports += [json.loads(actor.stdout.readline()) for actor in actors]
    finally:
        for actor in actors:
            actor.stdin.close()
        for actor in actors:
            try:
                actor.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                actor.kill()


def wait_until_filled(store: ExperienceStore) -> None:
    """Wait until the replay is full; until then its memory is touched for the first time, which costs."""
    deadline = time.monotonic() + _FILLED_WITHIN
    while store.replay.sequences < store.replay.slots:
        if time.monotonic() > deadline:
            sys.exit(f"the replay was not full within {_FILLED_WITHIN:g} s")
        time.sleep(0.1)
