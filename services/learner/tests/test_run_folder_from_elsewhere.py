"""Whatever a run's folder holds is named in one line, the checkpoint before is used, and nothing hangs."""

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from athrl_learner import factories
from athrl_learner.checkpoint import CheckpointContent, newest_intact_checkpoint, write_checkpoint
from athrl_learner.checkpoint.content import manifest_checksum
from athrl_learner.checkpoint.reading import MOST_JSON_BYTES, MOST_TENSOR_BYTES
from athrl_learner.checkpoint.recovery import Recovery
from athrl_learner.components import make_experience
from athrl_learner.errors import CannotResume
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.log import Kind, LogPosition, SegmentLog, numbered_segments
from athrl_protocol.delivery.ledger import Ledger

STATE = {
    "run_file": {"run": {"name": "small"}},
    "environment_steps": 100,
    "updates": 3,
    "policy_version": 10,
    "limiter": {"inserts": 3, "samples": 4},
    "ledger": {"actor-1": {"17": 3}},
    "totals": {"stored": 3},
    "replay": {"inserted": 3, "sequences": 3, "random": [2**64 - 1, 0]},
    "policy": "{}",
}
AGENT = {"planner": {"weight": torch.arange(6.0)}, "priorities": {}}


def position_of(log: SegmentLog, body: bytes = b"body") -> LogPosition:
    log.append(Kind.CHUNK, body)
    segments = tuple(log.seal())
    return LogPosition(log.next_segment, log.next_record, segments[0].first, 1, segments)


@pytest.fixture
def checkpoints(tmp_path: Path) -> Path:
    """A folder with two checkpoints, whose log lies beside it."""
    log = SegmentLog(tmp_path / "experience", segment_bytes=1, fsync="never")
    for number in (1, 2):
        state = {**STATE, "updates": number}
        write_checkpoint(tmp_path / "checkpoints", CheckpointContent(state, AGENT, position_of(log)))
    log.close()
    return tmp_path / "checkpoints"


@pytest.fixture
def used(checkpoints: Path, caplog: pytest.LogCaptureFixture) -> Callable[[], str]:
    """Expect that the checkpoint before is used; returns the one line that says why."""

    def look() -> str:
        found = newest_intact_checkpoint(checkpoints, checkpoints.parent / "experience")
        assert found is not None
        assert found[1].state["updates"] == 1
        (record,) = caplog.records
        line = record.getMessage()
        assert line == " ".join(line.split())
        assert len(line) < 600
        assert line.endswith("; using the one before")
        return line

    return look


def reseal(checkpoint: Path, change: Callable[[dict[str, Any]], object] = lambda values: None) -> None:
    """Change a manifest and make all checksums fit."""
    path = checkpoint / "manifest.json"
    values = json.loads(path.read_bytes())
    for name, facts in values["files"].items():
        facts["sha256"] = hashlib.sha256((checkpoint / name).read_bytes()).hexdigest()
    change(values)
    values["sha256"] = manifest_checksum(values)
    path.write_text(json.dumps(values))


MANIFESTS = {
    "deep": b"[" * 100_000,
    "deep and closed": b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
    "no object": b"[1]",
    "nothing": b"{}",
    "large": b" " * (MOST_JSON_BYTES + 1),
    "digits": b'{"format": ' + b"1" * 5_001 + b"}",
    "no text": b"\xff\xfe",
}


@pytest.mark.parametrize("content", MANIFESTS.values(), ids=MANIFESTS)
def test_manifest_of_nonsense_is_named_and_the_one_before_is_used(checkpoints, used, content):
    path = checkpoints / "checkpoint-000002" / "manifest.json"
    path.write_bytes(content)
    assert str(path) in used()


def outside(values: dict[str, Any]) -> None:
    values["files"]["../../../../../../dev/zero"] = {"sha256": "0"}


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "another file": outside,
    "no facts": lambda values: values["files"].update({"agent.pt": None}),
    "no files": lambda values: values.pop("files"),
    "files of numbers": lambda values: values.update(files=[1, 2]),
    "no log": lambda values: values.update(log=None),
    "log without segments": lambda values: values["log"].pop("segments"),
    "segment of text": lambda values: values["log"].update(segments=["a"]),
    "segment with more": lambda values: values["log"]["segments"][0].update(more=1),
    "records without end": lambda values: values["log"]["segments"][0].update(records=2**62),
    "segment without end": lambda values: values["log"]["segments"][0].update(number=2**62),
    "number beyond 64 bits": lambda values: values["log"].update(next_record=2**63),
    "negative number": lambda values: values["log"].update(oldest_left=-1),
    "number of text": lambda values: values["log"].update(oldest="3"),
    "version of text": lambda values: values.update(policy_version="3"),
    "format of text": lambda values: values.update(format="4"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_manifest_with_a_wrong_value_is_named_and_the_one_before_is_used(checkpoints, used, change):
    reseal(checkpoints / "checkpoint-000002", change)
    assert "manifest.json is damaged (" in used()


STATES: dict[str, Any] = {
    "list": [],
    "deep": "deep",
    "no run file": {key: value for key, value in STATE.items() if key != "run_file"},
    "steps of text": {**STATE, "environment_steps": "100"},
    "steps beyond 64 bits": {**STATE, "environment_steps": 2**64},
    "steps below 0": {**STATE, "environment_steps": -1},
    "limiter without samples": {**STATE, "limiter": {"inserts": 3}},
    "ledger of lists": {**STATE, "ledger": {"actor-1": [1]}},
    "totals of numbers that are none": {**STATE, "totals": {"stored": float("nan")}},
    "policy of a number": {**STATE, "policy": 1},
}


@pytest.mark.parametrize("state", STATES.values(), ids=STATES)
def test_state_with_a_wrong_value_is_named_and_the_one_before_is_used(checkpoints, used, state):
    path = checkpoints / "checkpoint-000002" / "state.json"
    path.write_text("[" * 100_000 if state == "deep" else json.dumps(state))
    reseal(path.parent)
    assert "state.json is damaged (" in used()


def repeated(levels: int) -> list[Any]:
    """A list that two to the power of `levels` ways lead into, and that takes little place in a file."""
    inner: list[Any] = [1]
    for _ in range(levels):
        inner = [inner, inner]
    return inner


AGENTS: dict[str, Any] = {
    "list": [1],
    "without priorities": {"planner": {}},
    "planner of numbers": {"planner": 1, "priorities": {}},
    "a list in itself a billion times": {"planner": {"x": repeated(60)}, "priorities": {}},
    "a tensor that repeats its number": {"planner": {"x": torch.zeros(1).expand(2**40)}, "priorities": {}},
    "a tensor of no data": {"planner": {"x": torch.empty(2**40, device="meta")}, "priorities": {}},
}


@pytest.mark.parametrize("agent", AGENTS.values(), ids=AGENTS)
def test_tensors_that_announce_more_than_they_hold_are_refused(checkpoints, used, agent):
    path = checkpoints / "checkpoint-000002" / "agent.pt"
    torch.save(agent, path)
    reseal(path.parent)
    assert "agent.pt is damaged (" in used()


def test_archive_that_unpacks_to_more_than_it_is_is_refused(checkpoints, used):
    path = checkpoints / "checkpoint-000002" / "agent.pt"
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, held in entries.items():
            archive.writestr(name, held + bytes(10**7) if name.endswith("data/0") else held)
    path.write_bytes(packed.getvalue())
    reseal(path.parent)
    assert "has compressed entries" in used()


@pytest.mark.parametrize("name", ["manifest.json", "state.json", "agent.pt"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "large"])
def test_what_is_no_file_of_a_checkpoint_is_refused_without_a_wait(checkpoints, used, name, kind):
    path = checkpoints / "checkpoint-000002" / name
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.touch()
        os.truncate(path, MOST_TENSOR_BYTES + 1)
    assert name in used()


def test_checkpoint_whose_segments_are_gone_is_named_and_the_one_before_is_used(checkpoints, used):
    experience = checkpoints.parent / "experience"
    reseal(checkpoints / "checkpoint-000002", lambda values: values["log"]["segments"].pop(0))
    numbered_segments(experience)[2].unlink()
    line = used()
    assert f"checkpoint {checkpoints / 'checkpoint-000002'} is gone" in line
    assert f"{experience} has no segment 2" in line


def test_run_whose_segments_are_all_gone_is_told_what_can_be_done(checkpoints):
    experience = checkpoints.parent / "experience"
    for path in experience.iterdir():
        path.unlink()
    with pytest.raises(CannotResume) as caught:
        newest_intact_checkpoint(checkpoints, experience)
    line = str(caught.value)
    assert "\n" not in line
    for told in (
        str(experience),
        "segments 1 to 2",
        "from a copy of the run's folder",
        "run.name",
        "policies",
    ):
        assert told in line, line


def test_run_whose_segments_are_gone_does_not_begin_again_from_its_first_checkpoint(tmp_path):
    # The best checkpoint is kept and may be the very first: with it all training would be lost unnoticed.
    checkpoints, experience = tmp_path / "checkpoints", tmp_path / "experience"
    write_checkpoint(checkpoints, CheckpointContent(STATE, AGENT, LogPosition(1, 0, 0, 0, ())))
    assert newest_intact_checkpoint(checkpoints, experience) is not None
    log = SegmentLog(experience, segment_bytes=1, fsync="never")
    write_checkpoint(checkpoints, CheckpointContent(STATE, AGENT, position_of(log)))
    log.close()
    numbered_segments(experience)[1].unlink()
    with pytest.raises(CannotResume, match="from a copy of the run's folder"):
        newest_intact_checkpoint(checkpoints, experience)


def test_checkpoint_of_another_run_is_named_and_the_one_before_is_used(checkpoints, used, tmp_path):
    other = SegmentLog(tmp_path / "other", segment_bytes=1, fsync="never")
    position_of(other)
    position = position_of(other, b"another run's")
    other.close()
    write_checkpoint(checkpoints, CheckpointContent({**STATE, "updates": 9}, AGENT, position))
    (checkpoints / "checkpoint-000002").rename(tmp_path / "aside")
    segment = numbered_segments(tmp_path / "experience")[2]
    assert f"checkpoint-000003 is of another run: {segment} is not the segment that it names" in used()


@pytest.fixture
def restore(run_file, tmp_path) -> Callable[[], Recovery]:
    """Restore all experience of the log in `tmp_path`."""

    def run() -> Recovery:
        agent = factories.make_agent(run_file)
        store = make_experience(run_file, agent, Arrivals(), factories.make_log(run_file, tmp_path))
        recovery = Recovery(store, Ledger(), None)
        recovery.run(None)
        return recovery

    return run


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 100_000,
        b"null",
        b"{}",
        b'{"actor": "a", "incarnation": 1, "sequence": 1e400}',
        b'{"actor": "a", "incarnation": -1, "sequence": 1}',
        b'{"actor": ["a"], "incarnation": 1, "sequence": 1}',
        b'{"actor": "a", "incarnation": 1, "sequence": 1099511627776}',
        b'{"actor": "a", "incarnation": 1, "sequence": ' + b"1" * 5_001 + b"}",
        b"\xff",
    ],
)
def test_refusal_in_the_log_of_nonsense_names_its_record(restore, tmp_path, body):
    log = SegmentLog(tmp_path, segment_bytes=10**6, fsync="never")
    log.append(Kind.REFUSAL, body)
    log.close()
    with pytest.raises(CannotResume, match=rf"^record 0 of {tmp_path}: ") as caught:
        restore()
    assert "\n" not in str(caught.value)


def test_refusal_that_comes_twice_in_the_log_counts_once(restore, tmp_path):
    log = SegmentLog(tmp_path, segment_bytes=10**6, fsync="never")
    for sequence in (5, 2, 5):
        log.append(Kind.REFUSAL, json.dumps({"actor": "a", "incarnation": 1, "sequence": sequence}).encode())
    log.close()
    ledger = restore()._ledger
    assert ledger.next_sequence("a", 1) == 6
    assert (ledger.totals.refused, ledger.totals.lost) == (1, 5)


def test_segment_that_is_no_file_is_refused_without_a_wait(restore, tmp_path):
    os.mkfifo(tmp_path / "segment-00000001.log")
    with pytest.raises(CannotResume, match=r"segment-00000001.log of the log is a pipe, socket or device"):
        restore()


def test_segment_that_is_damaged_in_a_thousand_places_fills_no_log(restore, tmp_path, caplog):
    log = SegmentLog(tmp_path, segment_bytes=10**6, fsync="never")
    for _ in range(1_000):
        log.append(Kind.CHUNK, b"body")
    log.close()
    path = numbered_segments(tmp_path)[1]
    path.write_bytes(path.read_bytes().replace(b"body", b"Body"))
    assert restore().damaged == 1_000
    assert len(caplog.records) < 50
    assert f"the log {tmp_path} has 1,000 damaged records" in caplog.text
