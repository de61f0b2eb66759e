"""Chunks that are sent under the name of an honest actor, with an actor's certificate.

All actors share one certificate here, so a chunk under a new incarnation is taken in: it is data like any
other. What must not happen is that an honest actor pays for it. So forged chunks are written down as if an
actor had made them, and the audit holds the log to that: each of them is there at most once, and no honest
chunk is lost, or there twice, because incarnations were pushed out of the ledger.
"""

from __future__ import annotations

import contextlib
import random
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TextIO

import zenoh
from athrl_protocol import ProtocolError, fetch_run_file, new_incarnation
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.schema import encode_message

from tests.chaos.content import read_chunk
from tests.chaos.flood import as_actor, is_refusal, known_messages
from tests.chaos.run import RUN, ChaosRun

_ANSWER_SECONDS = 2.0
_JOIN_SECONDS = 20.0
_NEWEST = 2**64 - 1
"""The largest incarnation that a message can have: of the year 2554."""


@dataclass
class Forgery:
    """Outcomes of forged chunks.

    Attributes:
        name: of the forger.
        sent: chunks.
        taken_in: acknowledged ones whose incarnation may be one of a real actor.
        refused: refused ones with an incarnation from the far future.
        admitted: acknowledged ones with such an incarnation; must be 0.
    """

    name: str
    sent: int = 0
    taken_in: int = 0
    refused: int = 0
    admitted: int = 0


def forge(run: ChaosRun, counts: Forgery, seed: int, seconds: float) -> None:
    """Send forged chunks for some seconds, from a restart that never was and from the far future in turns."""
    chance = random.Random(seed)
    known = known_messages(run, chance)
    if not known:
        return
    with contextlib.suppress(zenoh.ZError, ProtocolError), as_actor(run) as session:
        fetch_run_file(session, RUN, timeout=_JOIN_SECONDS)
        deadline = time.monotonic() + seconds
        with (run.evidence / f"{counts.name}.txt").open("a") as record:
            for number, chunk in enumerate(_forged(known, chance)):
                if time.monotonic() > deadline:
                    return
                future = number % 2 == 1
                chunk.incarnation = _NEWEST - number if future else new_incarnation()
                message = encode_message(chunk)
                if not future:
                    _write_down(record, message)
                _send(session, counts, chunk.actor, message, future)


def _forged(known: list[bytes], chance: random.Random) -> Iterator[athrl_pb2.Chunk]:
    """Yield chunks of the log as the first of another incarnation, each with a content of its own."""
    while True:
        chunk = athrl_pb2.Chunk.FromString(chance.choice(known))
        chunk.sequence = chunk.oldest_held = 0
        chunk.motion = struct.pack("<f", chance.uniform(-0.01, 0.01)) + chunk.motion[4:]
        yield chunk


def _write_down(record: TextIO, message: bytes) -> None:
    """Write down a chunk as `recording_actor` does, before it is sent."""
    identity, content = read_chunk(message)
    record.write(" ".join(map(str, ("produced", time.monotonic(), *identity, *content))) + "\n")
    record.flush()


def _send(session: zenoh.Session, counts: Forgery, actor: str, message: bytes, future: bool) -> None:
    counts.sent += 1
    for reply in session.get(Keys(RUN).experience(actor), payload=message, timeout=_ANSWER_SECONDS):
        if reply.ok is not None:
            counts.taken_in += not future
            counts.admitted += future
        elif reply.err is not None and future:
            counts.refused += is_refusal(reply.err.payload.to_bytes())
