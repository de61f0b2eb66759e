"""Messages and connections that must be refused.

The messages are sent with an actor's certificate, so only the learner's checks can refuse them.
"""

from __future__ import annotations

import contextlib
import functools
import random
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import zenoh
import zstandard
from athrl_learner.log import Kind, Record, SegmentReader, numbered_segments
from athrl_protocol import ProtocolError, fetch_run_file, open_session
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.schema import encode_message
from athrl_protocol.security.certificates import find_certificates

from tests.chaos.content import read_chunk
from tests.chaos.link_proxy import HOST
from tests.chaos.run import RUN, ChaosRun

_ANSWER_SECONDS = 2.0
_JOIN_SECONDS = 20.0
_IDLE_CONNECTIONS = 20
_MOST_SETTLING = 20
_REPEATED = 0.2
"""Known chunks for each malformed message."""
_TLS_ALERT = b"\x15"
_BOMB_BYTES = 60 * 2**20


@dataclass
class Flood:
    """Outcomes of a flood's messages.

    Attributes:
        name: name of the sender.
        sent: messages.
        refused: permanently refused by the learner.
        settled: of those sent, well-formed ones that do not fit the run: they enter the ledger.
        settled_answered: of those, the answered ones.
        accepted: acknowledged; must be 0.
        unanswered: dropped for their size, or sent while the learner was away.
        repeated: known chunks, sent again and acknowledged again.
    """

    name: str
    sent: int = 0
    refused: int = 0
    settled: int = 0
    settled_answered: int = 0
    accepted: int = 0
    unanswered: int = 0
    repeated: int = 0


class Malformed(NamedTuple):
    """A message that must be refused; its sender, and whether the refusal enters the ledger."""

    payload: bytes
    sender: str
    settles: bool = False


def flood(run: ChaosRun, counts: Flood, seed: int, seconds: float) -> None:
    """Send malformed messages for some seconds, and known chunks among them; count the outcomes."""
    chance = random.Random(seed)
    messages, known = malformed_messages(counts.name, chance), known_messages(run, chance)
    with contextlib.suppress(zenoh.ZError, ProtocolError), as_actor(run) as session:
        # A learner that serves the run file also accepts chunks.
        fetch_run_file(session, RUN, timeout=_JOIN_SECONDS)
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            _send(session, counts, next(messages))
            if known and chance.random() < _REPEATED:
                _repeat(session, counts, chance.choice(known))
        # Beyond the limit of the link; last, because it gets no answer.
        _send(session, counts, Malformed(bytes(2**24), counts.name), timeout=0.5)


def malformed_messages(name: str, chance: random.Random) -> Iterator[Malformed]:
    """Yield messages without end, all of which must be refused.

    Each well-formed message has its own sender, so that it is the first of its incarnation and independent of
    earlier messages; there are few of these, as the ledger keeps every sender.
    """
    settling = 0
    while True:
        make = chance.choice(_MAKERS if settling < _MOST_SETTLING else _NEVER_CHUNKS)
        settles = make in (_far_out, _other_shape)
        settling += settles
        sender = f"{name}-{settling}" if settles else name
        yield Malformed(make(_fitting(sender), chance), sender, settles)


def strangers(run: ChaosRun, seconds: float) -> dict[str, int]:
    """Connect without a certificate, in plain TCP, and without data; return how many were refused."""
    turned_away = {"plain": 0, "no_certificate": 0}
    deadline = time.monotonic() + seconds
    with contextlib.ExitStack() as stack:
        for _ in range(_IDLE_CONNECTIONS):
            with contextlib.suppress(OSError):
                stack.enter_context(socket.create_connection((HOST, run.port), timeout=1.0))
        while time.monotonic() < deadline:
            turned_away["plain"] += _turned_away(run, secure=False)
            turned_away["no_certificate"] += _turned_away(run, secure=True)
            time.sleep(0.05)
    return turned_away


def _send(
    session: zenoh.Session, counts: Flood, message: Malformed, timeout: float = _ANSWER_SECONDS
) -> None:
    counts.sent += 1
    counts.settled += message.settles
    answered = False
    key = Keys(RUN).experience(message.sender)
    for reply in session.get(key, payload=message.payload, timeout=timeout):
        if reply.ok is not None:
            counts.accepted += 1
            answered = True
        elif reply.err is not None and is_refusal(reply.err.payload.to_bytes()):
            counts.refused += 1
            counts.settled_answered += message.settles
            answered = True
    counts.unanswered += not answered


def known_messages(run: ChaosRun, chance: random.Random) -> list[bytes]:
    """Return the chunks of one segment of the log, as they arrived."""
    segments = list(numbered_segments(run.archive).items())
    if not segments:
        return []
    number, path = chance.choice(segments)
    items = SegmentReader(path, number, 0)
    return [item.body for item in items if isinstance(item, Record) and item.kind == Kind.CHUNK]


def _repeat(session: zenoh.Session, counts: Flood, message: bytes) -> None:
    """Send an acknowledged chunk again, as an actor that missed the acknowledgement would."""
    identity, _ = read_chunk(message)
    key = Keys(RUN).experience(identity.actor)
    for reply in session.get(key, payload=message, timeout=_ANSWER_SECONDS):
        counts.repeated += reply.ok is not None


def is_refusal(payload: bytes) -> bool:
    """Whether an error that answers a chunk is the learner's, which refuses it for good."""
    with contextlib.suppress(Exception):  # Zenoh's own time-out is not one of our messages
        return athrl_pb2.Refusal.FromString(payload).reason == athrl_pb2.Refusal.INVALID
    return False


def as_actor(run: ChaosRun) -> zenoh.Session:
    """Return a session with the certificate of the actors."""
    return open_session(
        connect=run.address, timeout=_JOIN_SECONDS, role="actor", certificates=run.certificates
    )


def _turned_away(run: ChaosRun, *, secure: bool) -> bool:
    """Whether a client that sends unknown data gets no answer."""
    try:
        with socket.create_connection((HOST, run.port), timeout=1.0) as plain:
            connection: socket.socket = plain
            if secure:
                shown = find_certificates(run.certificates, "viewer")
                assert shown is not None
                context = ssl.create_default_context(cafile=str(shown.authority))
                connection = context.wrap_socket(plain, server_hostname=HOST)
            connection.sendall(random.randbytes(300))
            return connection.recv(1) in (b"", _TLS_ALERT)
    except OSError:
        return True


def _fitting(sender: str) -> athrl_pb2.Chunk:
    """Return a valid chunk of the run, to be made invalid."""
    time_, size = 10, 32
    images = zstandard.compress(bytes((time_ + 1) * size * size * 4))
    message = athrl_pb2.Chunk(
        actor=sender,
        incarnation=1,
        time=time_,
        length=time_,
        state_interval=time_,
        image_height=size,
        image_width=size,
        image_channels=4,
        motion_size=2,
        images=images,
        motion=bytes(4 * 2 * (time_ + 1)),
        policy_version=bytes(8 * time_),
    )
    for level, actions in (("intention", 1), ("trajectory", 2)):
        message.levels.add(
            name=level,
            action_size=actions,
            actions=bytes(4 * actions * time_),
            rewards=bytes(4 * time_),
            states=bytes(4 * 64),
        )
    encode_message(message)  # sets the schema
    return message


Maker = Callable[[athrl_pb2.Chunk, random.Random], bytes]


def _noise(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    return b"\xff" + chance.randbytes(chance.choice([1, 16, 300, 5_000]))


def _cut_off(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    content = chunk.SerializeToString()
    return content[: chance.randrange(len(content) // 2)]


def _other_schema(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    chunk.schema_hash = chance.getrandbits(32)
    return chunk.SerializeToString()


def _bomb(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    chunk.images = _compressed_bomb(chance.random() < 0.5)
    return chunk.SerializeToString()


def _not_a_number(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    bad = np.full(10, chance.choice([np.nan, np.inf]), np.float32)
    chance.choice(chunk.levels).rewards = bad.tobytes()
    return chunk.SerializeToString()


def _far_out(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    chance.choice(chunk.levels).rewards = np.full(10, 1e30, np.float32).tobytes()
    return chunk.SerializeToString()


def _other_shape(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    chunk.motion_size, chunk.motion = 3, bytes(4 * 3 * 11)
    return chunk.SerializeToString()


def _too_large(chunk: athrl_pb2.Chunk, chance: random.Random) -> bytes:
    return bytes(2**22)


@functools.cache
def _compressed_bomb(announced: bool) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=announced).compress(bytes(_BOMB_BYTES))


_NEVER_CHUNKS: list[Maker] = [_noise, _cut_off, _other_schema, _bomb, _not_a_number, _too_large]
_MAKERS: list[Maker] = [*_NEVER_CHUNKS, _far_out, _other_shape]
