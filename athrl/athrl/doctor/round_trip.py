"""A trial of delivery: chunks are sent to a learner on this machine that is killed; none may be lost."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from athrl_protocol import Chunk, ChunkUploader, LevelColumns, decode_chunk, new_incarnation, open_session
from athrl_protocol.run_file import RunFile
from athrl_protocol.security.certificates import VARIABLE

from athrl.doctor.disk import room_left, run_place, scratch_folder
from athrl.doctor.finding import Finding, failed, ok, warning
from athrl.errors import CommandError
from athrl.ports import free_address

CHUNKS = 3_000
RUN = ACTOR = "doctor"
LOG_BYTES = 16 * 2**20
"""More than the size of all chunks."""
START_SECONDS, ROUND_TRIP_SECONDS = 60.0, 120.0


class Outcome(NamedTuple):
    """Counts of chunks by outcome, and the seconds without acknowledgements around the kill."""

    acknowledged: int
    lost: int
    twice: int
    stall: float


def round_trip(settings: RunFile) -> Iterator[Finding]:
    """Send some thousand chunks over loopback to a log on the run's disk, kill the receiver, and count."""
    if find_spec("athrl_learner") is None:
        yield ok("delivery", "not tested: no learner is installed here")
        return
    place = run_place(settings)
    if room_left(settings, place) < LOG_BYTES or not os.access(place, os.W_OK):
        yield warning(
            "delivery", f"not tested: {place} cannot be written", "see the run folder and the disk above"
        )
        return
    with scratch_folder(place) as scratch:
        outcome = delivery_trial(Path(scratch), CHUNKS, settings.durability.fsync)
    seen = (
        f"{outcome.acknowledged} chunks acknowledged over a kill of the receiver, lost {outcome.lost}, "
        f"twice {outcome.twice}, longest wait {outcome.stall:.1f} s; logged in {place}"
    )
    if outcome.lost or outcome.twice or outcome.acknowledged < CHUNKS:
        yield failed("delivery", seen, "do not use this machine for runs: try another file system")
    else:
        yield ok("delivery", seen)


def delivery_trial(folder: Path, chunks: int, fsync: str = "never") -> Outcome:
    """Deliver chunks into a log in `folder`, with a kill after a third of them; `fsync` as in the run file.

    Raises:
        CommandError: the receiver does not start, or not everything is acknowledged in time.
    """
    address = free_address()
    with contextlib.ExitStack() as stack:
        stack.enter_context(_without_certificates())
        receiver = stack.enter_context(_receiver(address, folder, fsync))
        session = stack.enter_context(open_session(connect=address, timeout=START_SECONDS))
        uploader = stack.enter_context(ChunkUploader(session, RUN, ACTOR, new_incarnation(), capacity=64))
        deadline = time.monotonic() + ROUND_TRIP_SECONDS
        _submit(uploader, range(chunks // 3), deadline)
        before = uploader.statistics().acknowledged
        killed_at = time.monotonic()
        receiver.kill()
        receiver.wait()
        stack.enter_context(_receiver(address, folder, fsync))
        while uploader.statistics().acknowledged <= before and time.monotonic() < deadline:
            time.sleep(0.01)
        stall = time.monotonic() - killed_at
        _submit(uploader, range(chunks // 3, chunks), deadline)
        if not uploader.flush(timeout=max(0.0, deadline - time.monotonic())):
            raise CommandError(f"not all chunks were acknowledged within {ROUND_TRIP_SECONDS:.0f} s")
        acknowledged = uploader.statistics().acknowledged
    return count(folder, acknowledged, stall)


def count(folder: Path, acknowledged: int, stall: float) -> Outcome:
    """Check the log: every sequence below `acknowledged` must be there once, with its own content."""
    from athrl_learner.log import Record, SegmentReader, numbered_segments

    found: Counter[int] = Counter()
    for number, path in numbered_segments(folder).items():
        for item in SegmentReader(path, number, 0):
            if isinstance(item, Record):
                chunk = decode_chunk(item.body)
                if chunk.episode_seed == chunk.sequence:
                    found[chunk.sequence] += 1
    lost = sum(sequence not in found for sequence in range(acknowledged))
    return Outcome(acknowledged, lost, sum(times > 1 for times in found.values()), stall)


def synthetic_chunk(number: int) -> Chunk:
    """Return a small chunk with its number in its content."""
    columns = LevelColumns(
        np.zeros((4, 2), np.float32), np.zeros(4, np.float32), np.zeros((1, 8), np.float32)
    )
    return Chunk(
        actor=ACTOR,
        incarnation=0,
        sequence=0,
        environment=0,
        episode_seed=number,
        first_step=0,
        length=4,
        state_interval=4,
        images=np.zeros((5, 8, 8, 4), np.uint8),
        motion=np.zeros((5, 2), np.float32),
        levels={"trajectory": columns},
        policy_version=np.zeros(4, np.int64),
        terminated=False,
        truncated=False,
    )


def _submit(uploader: ChunkUploader, numbers: range, deadline: float) -> None:
    for number in numbers:
        if not uploader.submit(synthetic_chunk(number), timeout=max(0.0, deadline - time.monotonic())):
            raise CommandError(f"chunk {number} was not accepted within {ROUND_TRIP_SECONDS:.0f} s")


@contextlib.contextmanager
def _receiver(address: str, folder: Path, fsync: str) -> Iterator[subprocess.Popen[str]]:
    """A light learner in a separate process, ready for chunks; ended with the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", "athrl.doctor.light_learner", address, str(folder), fsync],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        if not _says_ready(process):
            process.kill()
            said = process.communicate()[1].strip().splitlines() or ["it printed nothing"]
            raise CommandError(f"the receiver does not start: {said[-1]}")
        yield process
    finally:
        process.kill()
        process.communicate()


def _says_ready(process: subprocess.Popen[str]) -> bool:
    """Whether the receiver is ready for chunks; one that is not within `START_SECONDS` is ended."""
    assert process.stdout is not None
    late = threading.Timer(START_SECONDS, process.kill)
    late.start()
    try:
        return process.stdout.readline().strip() == "ready"
    finally:
        late.cancel()


@contextlib.contextmanager
def _without_certificates() -> Iterator[None]:
    """Use no certificates inside the block, whatever the environment says: this only tests delivery."""
    named = os.environ.pop(VARIABLE, None)
    try:
        yield
    finally:
        if named is not None:
            os.environ[VARIABLE] = named
