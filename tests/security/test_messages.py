"""Invalid messages of permitted senders are refused by reason and sender, and training continues."""

from __future__ import annotations

import contextlib
import logging
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
import zstandard
from athrl_protocol import (
    Chunk,
    ChunkUploader,
    InvalidMessage,
    LevelColumns,
    MetricsReport,
    MetricsSubscriber,
    decode_chunk,
    encode_chunk,
    new_incarnation,
    open_session,
)
from athrl_protocol.announcements import policy
from athrl_protocol.faults.refusals import OTHERS, SENDERS_KEPT, Refusals
from athrl_protocol.messages import athrl_pb2
from hypothesis import given, settings
from hypothesis import strategies as st

ROOT = Path(__file__).parents[2]
SECONDS = 200.0
PATIENCE = 30.0
TIME = 5

# A run that trains on little, and does not end before it is stopped.
SETTINGS = {
    "run.name": "guarded",
    "run.environment_steps": 1_000_000,
    "exploration.random_decisions": 50,
    "replay.sequence_length": TIME,
    "replay.burn_in": 1,
    "planner.memory": "lstm",
    "planner.recurrent_features": 8,
    "planner.shared_trunk": "false",
    "learner.samples_per_insert": 1.0,
}


def fitting_chunk(random: np.random.Generator) -> Chunk:
    """A chunk of the run, as an actor would make it."""

    def column(low: float, high: float, size: int) -> np.ndarray:
        return random.uniform(low, high, (TIME, size)).astype(np.float32)

    levels = {
        "intention": column(0, 2, 1),
        "trajectory": np.concatenate([column(0, 7.95, 1), column(-0.5, 0.5, 1)], axis=1),
    }
    rewards, states = np.zeros(TIME, np.float32), np.zeros((1, 16), np.float32)
    return Chunk(
        actor="unset",
        incarnation=0,
        sequence=0,
        environment=0,
        episode_seed=1,
        first_step=0,
        length=TIME,
        state_interval=TIME,
        images=random.integers(0, 2, (TIME + 1, 32, 32, 4), dtype=np.uint8) * np.uint8(255),
        motion=random.uniform(-1, 1, (TIME + 1, 2)).astype(np.float32),
        levels={name: LevelColumns(actions, rewards, states) for name, actions in levels.items()},
        policy_version=np.zeros(TIME, np.int64),
        terminated=False,
        truncated=False,
    )


class HonestActor:
    """Uploads chunks that fit until it is left; each has to be acknowledged."""

    def __init__(self, session: zenoh.Session) -> None:
        self._uploader = ChunkUploader(session, "guarded", "honest", new_incarnation(), capacity=8)
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._upload)
        self._thread.start()

    def _upload(self) -> None:
        random = np.random.default_rng(0)
        while not self._leave.is_set():
            self._uploader.submit(fitting_chunk(random), timeout=0.5)
            self._leave.wait(0.1)

    def leave(self) -> None:
        self._leave.set()
        self._thread.join(timeout=PATIENCE)
        self._uploader.close()

    @property
    def acknowledged(self) -> int:
        return self._uploader.statistics().acknowledged

    @property
    def given_up(self) -> int:
        return self._uploader.statistics().given_up


class LearnersMetrics:
    """What the learner tells of itself, once a second."""

    def __init__(self) -> None:
        self._came = threading.Condition()
        self._reports: list[dict[str, float]] = []

    def take(self, report: MetricsReport) -> None:
        with self._came:
            self._reports.append(report.values)
            self._came.notify_all()

    def newest(self) -> dict[str, float]:
        """Wait for a report that is made from now on, and return it."""
        with self._came:
            # The next one may have been under way.
            wanted = len(self._reports) + 2
            assert self._came.wait_for(lambda: len(self._reports) >= wanted, PATIENCE), self._reports
            return self._reports[-1]


@pytest.fixture(params=["encrypted", "plain"])
def run(request, command, tiny: list[str], port: int, ours: Path, sessions: contextlib.ExitStack):
    """A learner's process that trains on an honest actor's chunks; yields what it says and who connects."""
    words = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    certificates = ["--certificates", str(ours)] if request.param == "encrypted" else []
    process = command.start("learner", *tiny, *words, *certificates)
    command.wait_until_said(process, "listens at", SECONDS)

    def connect(role: str = "actor") -> zenoh.Session:
        folder = ours if certificates else None
        return sessions.enter_context(
            open_session(connect=f"127.0.0.1:{port}", timeout=PATIENCE, role=role, certificates=folder)
        )

    told = LearnersMetrics()
    sessions.enter_context(MetricsSubscriber(connect("viewer"), "guarded", told.take, role="learner"))
    actor = HonestActor(connect())
    try:
        yield connect, told.newest, actor, lambda: command.said(process)
        assert process.poll() is None, command.said(process)
    finally:
        actor.leave()


def hostile_messages() -> dict[str, bytes]:
    """What an actor whose program is broken, or taken over, could send."""
    chunk = replace(fitting_chunk(np.random.default_rng(1)), actor="hostile", incarnation=1)
    encoded = encode_chunk(chunk)

    def changed(change: Callable[[athrl_pb2.Chunk], None]) -> bytes:
        message = athrl_pb2.Chunk.FromString(encoded)
        change(message)
        return message.SerializeToString()

    def bomb(message: athrl_pb2.Chunk) -> None:
        message.images = zstandard.compress(bytes(60 * 2**20))

    def disguised_bomb(message: athrl_pb2.Chunk) -> None:
        message.images = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(60 * 2**20))

    def not_a_number(message: athrl_pb2.Chunk) -> None:
        message.levels[0].rewards = np.full(TIME, np.nan, np.float32).tobytes()

    def far_out(message: athrl_pb2.Chunk) -> None:
        message.levels[1].rewards = np.full(TIME, 1e38, np.float32).tobytes()

    def other_schema(message: athrl_pb2.Chunk) -> None:
        message.schema_hash = 1

    return {
        "malformed": b"\xff" * 5_000,
        "schema": changed(other_schema),
        "size": changed(bomb),
        "size of a disguised bomb": changed(disguised_bomb),
        "value": changed(not_a_number),
        "value beyond": changed(far_out),
        "size of the message": bytes(2**22),
    }


def test_hostile_messages_are_counted_by_reason_and_sender_and_training_goes_on(run, eventually) -> None:
    connect, metrics, actor, said = run
    hostile = connect()
    eventually(lambda: metrics().get("updates", 0) > 0, SECONDS)
    for payload in hostile_messages().values():
        answers = list(hostile.get("athrl/guarded/experience/hostile", payload=payload, timeout=PATIENCE))
        assert len(answers) == 1
        assert answers[0].err is not None
        assert (
            athrl_pb2.Refusal.FromString(answers[0].err.payload.to_bytes()).reason
            == athrl_pb2.Refusal.INVALID
        )
    # What is larger than any message of this run is dropped by Zenoh: there is no answer.
    too_large = bytes(2**26)
    answers = hostile.get(
        "athrl/guarded/experience/hostile",
        payload=too_large,
        timeout=1.0,
        congestion_control=zenoh.CongestionControl.BLOCK,
    )
    assert not any(answer.ok for answer in answers)

    before, updates = actor.acknowledged, metrics()["updates"]
    eventually(lambda: actor.acknowledged > before + 20, SECONDS)
    eventually(lambda: metrics()["updates"] > updates, SECONDS)
    # The refusals are told by metrics, which come once a second.
    eventually(lambda: metrics().get("intake/invalid") == 7, SECONDS)
    counts = metrics()
    refused = {name: count for name, count in counts.items() if name.startswith("intake/invalid/")}
    assert refused["intake/invalid/malformed/hostile"] == 1
    assert refused["intake/invalid/schema/hostile"] == 1
    assert refused["intake/invalid/size/hostile"] == 3
    assert refused["intake/invalid/value/hostile"] == 2
    assert counts["intake/invalid"] == 7
    assert not any("honest" in name for name in refused)
    assert actor.given_up == 0
    assert all(np.isfinite(value) for name, value in counts.items() if name.startswith("loss/")), counts
    assert "a chunk of hostile was refused (schema)" in said()


@pytest.mark.parametrize("run", ["plain"], indirect=True)  # what is counted has left the encryption behind
def test_flood_of_refused_messages_is_a_few_lines_of_log(run, eventually) -> None:
    connect, metrics, actor, said = run
    hostile = connect()
    for number in range(2_000):
        name = f"hostile-{number % 100}"
        list(hostile.get(f"athrl/guarded/experience/{name}", payload=bytes(number), timeout=PATIENCE))
    eventually(lambda: metrics().get("intake/invalid") == 2_000, SECONDS)
    counts = metrics()
    named = [name for name in counts if name.startswith("intake/invalid/malformed/")]
    assert len(named) <= SENDERS_KEPT + 1
    assert said().count("was refused") < 200
    before = actor.acknowledged
    eventually(lambda: actor.acknowledged > before, SECONDS)


@settings(max_examples=100, deadline=None)
@given(
    content=st.integers(0, 64 * 2**20),
    time=st.integers(0, 2**32 - 1),
    height=st.integers(0, 2**32 - 1),
    announced=st.booleans(),
)
def test_images_unpack_to_what_the_message_announces_or_not_at_all(
    content: int, time: int, height: int, announced: bool
) -> None:
    message = athrl_pb2.Chunk.FromString(
        encode_chunk(replace(fitting_chunk(np.random.default_rng(1)), actor="hostile"))
    )
    right = (message.time, message.image_height)
    compressor = zstandard.ZstdCompressor(level=1, write_content_size=announced)
    message.images = compressor.compress(bytes(content))
    message.time, message.image_height = time, height
    if (time, height) == right and content == (TIME + 1) * 32 * 32 * 4 and announced:
        assert decode_chunk(message.SerializeToString()).time == TIME
        return
    with pytest.raises(InvalidMessage):
        decode_chunk(message.SerializeToString())


def test_policy_that_is_not_what_its_hash_says_is_not_used() -> None:
    update = policy.PolicyUpdate(3, b"an artefact", False, 1.0, 1, 2, time.time())
    message = athrl_pb2.Policy.FromString(policy._encode(update))
    assert policy._decode(message.SerializeToString()).artefact == b"an artefact"
    for artefact in (b"another artefact", b"", b"an artefacT"):
        message.artefact = artefact
        with pytest.raises(InvalidMessage, match="arrived damaged"):
            policy._decode(message.SerializeToString())


def test_senders_who_call_themselves_anything_are_counted_together() -> None:
    refusals = Refusals("a chunk", logging.getLogger(__name__))
    for name in ("", "a/b", "x" * 1_000, "new\nline", *(f"sender-{number}" for number in range(1_000))):
        refusals.add(name, InvalidMessage("size", "too much"))
    counts = refusals.by_sender()
    assert len(counts) == SENDERS_KEPT
    assert counts[OTHERS] == {"size": 1_004 - (SENDERS_KEPT - 1)}
    assert refusals.by_reason() == {"size": 1_004}


def test_fuzzed_messages_are_refused_or_proper() -> None:
    """The long run of the same: python -m benchmarks.fuzz."""
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks.fuzz", "--short", "--seed", "5"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert result.returncode == 0, result.stderr[-2000:]
    thrown = re.search(r"^([\d,]+) messages in", result.stdout, re.MULTILINE)
    assert thrown is not None
    assert int(thrown[1].replace(",", "")) >= 20_000
