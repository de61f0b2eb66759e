"""Compares the actors' records with the learner's disk."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from athrl_learner.checkpoint.content import STATE, numbered_checkpoints
from athrl_learner.log import Kind, Record, SegmentReader, numbered_segments
from athrl_protocol.delivery.ledger import FORGOTTEN

from tests.chaos.content import Content, Identity, read_chunk
from tests.chaos.evidence import Evidence
from tests.chaos.flood import Flood


@dataclass
class Log:
    """Everything that the learner wrote to its log.

    Attributes:
        chunks: all chunks, in order.
        messages: messages of the chunks, as they arrived.
        refusals: chunks that were refused permanently.
        problems: missing or unreadable parts, one line each.
    """

    chunks: list[tuple[Identity, Content]] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    refusals: list[Identity] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def read_log(folder: Path) -> Log:
    """Read all segments in a folder, which must be complete."""
    log, expected = Log(), 0
    for number, path in numbered_segments(folder).items():
        reader = SegmentReader(path, number, expected)
        for item in reader:
            if not isinstance(item, Record):
                log.problems.append(str(item))
                continue
            if item.number != expected:
                log.problems.append(f"{path.name}: record {item.number} comes where {expected} should")
            expected = item.number + 1
            if item.kind == Kind.CHUNK:
                log.chunks.append(read_chunk(item.body))
                log.messages.append(item.body)
            else:
                log.refusals.append(Identity(**json.loads(item.body)))
    return log


@dataclass
class Account:
    """Result of the comparison; all but the first four fields must be zero.

    Attributes:
        produced: chunks that actors made.
        acknowledged: chunks that were acknowledged to actors.
        stored: chunks in the log.
        transitions: valid steps in these.
        lost: acknowledged, but not in the log with that content.
        twice: more than once in the log, by identity or by content.
        foreign: in the log with a content that no actor recorded.
    """

    produced: int
    acknowledged: int
    stored: int
    transitions: int
    lost: int
    twice: int
    foreign: int


def compare(evidence: Evidence, log: Log) -> Account:
    """Compare the log with the actors' records."""
    acknowledged = evidence.settled["acknowledged"]
    there = set(log.chunks)
    identities = Counter(identity for identity, _ in log.chunks)
    contents = Counter(content.digest for _, content in log.chunks)
    # A chunk that is stored twice under one identity also has its content twice, and counts once.
    twice = {identity for identity, count in identities.items() if count > 1}
    twice |= {identity for identity, content in log.chunks if contents[content.digest] > 1}
    return Account(
        produced=len(evidence.produced),
        acknowledged=len(acknowledged),
        stored=len(log.chunks),
        transitions=sum(content.length for _, content in log.chunks),
        lost=sum(chunk not in there for chunk in acknowledged.items()),
        twice=len(twice),
        foreign=sum(evidence.produced.get(identity) != content for identity, content in log.chunks),
    )


def imbalances(evidence: Evidence, log: Log, checkpoints: Path, floods: list[Flood]) -> list[str]:
    """Return every counter that does not agree with the others, one line each."""
    return [
        *actors_imbalances(evidence),
        *_learner_imbalances(log, checkpoints),
        *_refusals_imbalances(evidence, log, floods),
    ]


def actors_imbalances(evidence: Evidence) -> list[str]:
    """Counters of each process that ended gracefully against its own records."""
    events = {
        "produced": Counter(identity[:2] for identity in evidence.produced),
        **{event: Counter(identity[:2] for identity in of) for event, of in evidence.settled.items()},
    }
    empty: Counter[tuple[str, int]] = Counter()
    found = []
    for life, counters in evidence.counters.items():
        acknowledged, refused, given_up, unencoded = (
            events.get(event, empty)[life] for event in ("acknowledged", "refused", "given-up", "unencoded")
        )
        seen = {
            "produced": events["produced"][life] + unencoded,
            "acknowledged": acknowledged,
            "given_up": refused + given_up + unencoded,
        }
        # Chunks that were not submitted because the bound was reached are not recorded.
        left_out = counters["given_up_by_reason"]["bound"]
        said = {
            "produced": counters["produced"] - left_out,
            "acknowledged": counters["acknowledged"],
            "given_up": counters["given_up"] - left_out,
        }
        settled = counters["acknowledged"] + counters["given_up"] + counters["waiting"]
        if said != seen or settled != counters["produced"]:
            found.append(f"{life[0]} counts {counters}, and recorded {seen}")
    return found


def _learner_imbalances(log: Log, checkpoints: Path) -> list[str]:
    """Counters of the last checkpoint, written at the orderly end, against the log."""
    _, newest = numbered_checkpoints(checkpoints)[-1]
    state = json.loads((newest / STATE).read_bytes())
    totals = state["totals"]
    settled = sum(
        sum(incarnations.values()) for actor, incarnations in state["ledger"].items() if actor != FORGOTTEN
    )
    transitions = sum(content.length for _, content in log.chunks)
    pairs = {
        "stored chunks": (totals["stored"], len(log.chunks)),
        "refused chunks": (totals["refused"], len(log.refusals)),
        "lost chunks": (totals["lost"], 0),
        "damaged records": (state["damaged"], 0),
        "settled chunks": (settled, totals["stored"] + totals["refused"] + totals["lost"]),
        "transitions": (totals["transitions"], transitions),
        "environment steps": (state["environment_steps"], transitions),
    }
    return [
        f"{newest.name}: {what}: {is_} instead of {should}"
        for what, (is_, should) in pairs.items()
        if is_ != should
    ]


def _refusals_imbalances(evidence: Evidence, log: Log, floods: list[Flood]) -> list[str]:
    """Refusals in the log must be the flood's well-formed messages, and no honest actor may be refused."""
    found = [
        f"{flood.name}: {flood.accepted} malformed messages were accepted"
        for flood in floods
        if flood.accepted
    ]
    answered = sum(flood.settled_answered for flood in floods)
    sent = sum(flood.settled for flood in floods)
    if not answered <= len(log.refusals) <= sent:
        found.append(f"{len(log.refusals)} refusals in the log, of {sent} sent and {answered} answered")
    honest = len(evidence.settled["refused"])
    if honest:
        found.append(f"{honest} chunks of actors were refused")
    return found
