"""Checkpoints: what is read is what was written, and a kill or a damaged disk costs the newest at most."""

import dataclasses
import errno
import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from athrl_learner.checkpoint import (
    BestCheckpoint,
    CheckpointContent,
    newest_intact_checkpoint,
    read_checkpoint,
    remove_unfinished,
    remove_unneeded,
    write_checkpoint,
)
from athrl_learner.checkpoint.checkpointer import Checkpointer
from athrl_learner.checkpoint.content import manifest_checksum
from athrl_learner.errors import CannotResume, CheckpointFailed, DamagedCheckpoint
from athrl_learner.log import Kind, LogPosition, SegmentFacts, SegmentLog, numbered_segments


def content(number: int = 0) -> CheckpointContent:
    state = {
        "number": number,
        "run_file": {"run": {"name": "small"}},
        "environment_steps": 100 * number,
        "updates": number,
        "policy_version": 10 * number,
        "limiter": {"inserts": 3, "samples": 4},
        "ledger": {"actor-1": {"17": 3}},
        "totals": {"stored": 3},
        "replay": {"inserted": 3, "sequences": 3, "random": [2**64 - 1, 0]},
        "policy": "{}",
    }
    weights = {"intention": {"weight": torch.full((3, 2), float(number))}}
    return CheckpointContent(
        state=state,
        agent={"planner": {"updates": number, "levels": weights}, "priorities": {}},
        log=LogPosition(number + 2, 70, 50, 1, (SegmentFacts(number + 1, 40, 30, 4321, "abcd"),)),
    )


def write_and_keep(folder, number, kept, files=None):
    path = write_checkpoint(folder, content(number), files)
    remove_unneeded(folder, kept, BestCheckpoint(folder, files), files)
    return path


def test_a_checkpoint_holds_exactly_what_was_given(tmp_path):
    written = content(5)
    read = read_checkpoint(write_checkpoint(tmp_path, written))
    assert read.state == written.state
    assert read.log == written.log
    assert torch.equal(read.agent["planner"]["levels"]["intention"]["weight"], torch.full((3, 2), 5.0))


def test_only_the_newest_are_kept(tmp_path):
    for number in range(5):
        write_and_keep(tmp_path, number, kept=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint-000004", "checkpoint-000005"]
    _, newest = newest_intact_checkpoint(tmp_path)
    assert newest.state["number"] == 4


def test_the_best_is_kept_beside_the_newest(tmp_path):
    # Checkpoint n has policy version 10 (n - 1); scores are of versions in between.
    new_scores = {2: [(11, 5.0)], 3: [(19, 100.0), (28, 3.0)], 5: [(41, 90.0)], 7: [(60, float("nan"))]}
    for number in range(8):
        best = BestCheckpoint(tmp_path)  # a new learner each time
        for version, score in new_scores.get(number, []):
            best.add_score(version, score)
        write_checkpoint(tmp_path, content(number))
        kept = remove_unneeded(tmp_path, 2, best)
    names = sorted(path.name for path in tmp_path.glob("checkpoint-*"))
    assert names == ["checkpoint-000003", "checkpoint-000007", "checkpoint-000008"]
    assert read_checkpoint(tmp_path / names[0]).state["policy_version"] == 20
    assert [position.next_segment for position in kept.newest] == [8, 9]
    assert [position.next_segment for position in kept.others] == [4]


def test_a_score_goes_to_the_nearest_checkpoint_and_waits_for_one(tmp_path):
    best = BestCheckpoint(tmp_path)
    best.add_score(7, 1.0)
    assert best.choose({}) is None
    assert best.choose({"a": 0, "b": 10}) == "b"
    best.add_score(1, 2.0)
    assert best.choose({"a": 0, "b": 10}) == "a"
    best.add_score(4, 9.0)  # farther from "a" than the score that it has
    assert best.choose({"a": 0, "b": 10}) == "a"
    assert BestCheckpoint(tmp_path).choose({"a": 0, "b": 10}) == "a"
    assert BestCheckpoint(tmp_path).choose({"b": 10}) == "b"


def test_a_folder_without_checkpoints_has_no_newest(tmp_path):
    assert newest_intact_checkpoint(tmp_path) is None
    assert newest_intact_checkpoint(tmp_path / "missing") is None


@pytest.mark.parametrize("name", ["agent.pt", "state.json", "manifest.json"])
@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_a_damaged_file_is_named_and_the_checkpoint_before_is_used(tmp_path, caplog, name, damage):
    older = write_checkpoint(tmp_path, content(1))
    newest = write_checkpoint(tmp_path, content(2))
    file = newest / name
    stored = bytearray(file.read_bytes())
    if damage == "flip":
        stored[len(stored) // 2] ^= 0xFF
        file.write_bytes(stored)
    elif damage == "cut":
        file.write_bytes(stored[:-1])
    else:
        file.unlink()
    path, used = newest_intact_checkpoint(tmp_path)
    assert path == older
    assert used.state["number"] == 1
    assert str(file) in caplog.text
    assert "using the one before" in caplog.text


def test_only_damaged_checkpoints_are_an_error_and_no_new_start(tmp_path, caplog):
    (write_checkpoint(tmp_path, content()) / "agent.pt").write_bytes(b"")
    with pytest.raises(CannotResume, match="damaged"):
        newest_intact_checkpoint(tmp_path)
    assert "there is none before" in caplog.text


def test_an_actor_in_the_same_process_comes_back_with_the_checkpoint(tmp_path):
    alone = content()
    assert read_checkpoint(write_checkpoint(tmp_path, alone)).actor is None
    actor = {"steps": [1, 2], "state": torch.arange(3.0)}
    path = write_checkpoint(tmp_path, dataclasses.replace(alone, actor=actor))
    read = read_checkpoint(path).actor
    assert read["steps"] == [1, 2]
    assert torch.equal(read["state"], actor["state"])
    (path / "actor.pt").write_bytes(b"")
    with pytest.raises(DamagedCheckpoint, match=r"actor\.pt"):
        read_checkpoint(path)


def test_a_pickle_with_the_right_checksum_is_refused(tmp_path):
    # A file that does something when it is unpickled, with a manifest made to fit it.
    written = content()
    path = write_checkpoint(
        tmp_path,
        CheckpointContent(written.state, {"planner": {"threat": Threat()}, "priorities": {}}, written.log),
    )
    with pytest.raises(DamagedCheckpoint, match=r"agent\.pt is damaged \(holds something besides tensors"):
        read_checkpoint(path)
    assert not Threat.carried_out


class Threat:
    carried_out = False

    def __reduce__(self):
        return (setattr, (Threat, "carried_out", True))


def test_another_format_is_refused_by_number(tmp_path):
    path = write_checkpoint(tmp_path, content())
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["format"] = 99
    manifest["sha256"] = manifest_checksum(manifest)
    (path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(CannotResume, match="format 99"):
        newest_intact_checkpoint(tmp_path)


@pytest.mark.parametrize("bits", ["one of each byte", pytest.param("all", marks=pytest.mark.slow)])
def test_no_flipped_bit_of_a_manifest_passes_or_stops_the_run(tmp_path, bits):
    older = write_checkpoint(tmp_path, content(1))
    file = write_checkpoint(tmp_path, content(2)) / "manifest.json"
    stored = file.read_bytes()
    meant = json.loads(stored)
    for position in range(len(stored)):
        for bit in range(8) if bits == "all" else [random.randrange(8)]:
            flipped = bytearray(stored)
            flipped[position] ^= 1 << bit
            file.write_bytes(flipped)
            path, _ = newest_intact_checkpoint(tmp_path)
            assert path == older or json.loads(flipped) == meant, (position, bit)


def test_a_manifest_with_another_number_is_damaged(tmp_path):
    path = write_checkpoint(tmp_path, content())
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["log"]["oldest"] += 1
    (path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(DamagedCheckpoint, match=r"manifest\.json"):
        read_checkpoint(path)


def write_three(folder, files=None):
    """What a run does to its folder: checkpoint after checkpoint, of which two are kept."""
    for number in range(1, 5):
        best = BestCheckpoint(folder, files)
        best.add_score(10 * number, -number)  # the first stays the best
        write_checkpoint(folder, content(number), files)
        remove_unneeded(folder, 2, best, files)


def test_a_death_at_any_operation_leaves_a_loadable_checkpoint(tmp_path, faults):
    complete = faults.FaultyFiles()
    write_three(tmp_path / "whole", complete)
    assert complete.operations > 60
    newest = 0
    for operation in range(complete.operations):
        folder = tmp_path / str(operation)
        with pytest.raises(faults.Died):
            write_three(folder, faults.FaultyFiles(dies_at=operation))
        remove_unfinished(folder)
        found = newest_intact_checkpoint(folder)
        number = found[1].state["number"] if found is not None else 0
        assert number >= newest, "a later death left an older checkpoint"
        newest = number
        # A resumed learner can write, and all names are free.
        assert read_checkpoint(write_and_keep(folder, 9, kept=2)).state["number"] == 9
        assert all(path.name == "scores.json" or read_checkpoint(path) for path in folder.iterdir())
    assert newest == 4


def test_a_disk_that_refuses_leaves_the_checkpoints_before(tmp_path, faults):
    complete = faults.FaultyFiles()
    write_checkpoint(tmp_path / "whole", content(1), complete)
    for operation in range(complete.operations - 1):  # the last one brings the new name to the disk
        folder = tmp_path / str(operation)
        write_checkpoint(folder, content(1))
        with pytest.raises(CheckpointFailed, match="input/output error"):
            write_checkpoint(folder, content(2), faults.FaultyFiles(fails_at=operation))
        assert newest_intact_checkpoint(folder)[1].state["number"] == 1


def test_a_folder_that_cannot_be_read_is_a_checkpoint_that_failed(tmp_path, monkeypatch):
    def fails(self: Path) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "iterdir", fails)
    with pytest.raises(CheckpointFailed, match=f"folder of checkpoints {tmp_path}: input/output error"):
        write_checkpoint(tmp_path, content(1))


def test_a_checkpoint_frees_the_segments_that_none_needs(tmp_path):
    log = SegmentLog(tmp_path / "experience", segment_bytes=1, fsync="never")
    checkpointer = Checkpointer(
        tmp_path / "checkpoints", log, BestCheckpoint(tmp_path / "checkpoints"), seconds=1e9, kept=2
    )
    for number in range(1, 9):
        log.append(Kind.CHUNK, b"%d" % number)
        segments = tuple(log.seal()[-3:])  # the replay has room for three
        position = LogPosition(log.next_segment, log.next_record, segments[0].first, 1, segments)
        checkpointer.write_now(dataclasses.replace(content(number), log=position))
    assert list(numbered_segments(log.folder)) == [5, 6, 7, 8]


def test_a_checkpoint_that_fails_in_whatever_way_while_training_continues_is_counted(tmp_path, caplog):
    log = SegmentLog(tmp_path / "experience", segment_bytes=1, fsync="never")
    best = BestCheckpoint(tmp_path / "checkpoints")
    checkpointer = Checkpointer(tmp_path / "checkpoints", log, best, seconds=1e9, kept=2)
    checkpointer.write_in_background(dataclasses.replace(content(1), state={"number": object()}))
    assert checkpointer.wait()
    assert (checkpointer.written, checkpointer.failed) == (0, 1)
    assert caplog.messages == ["a checkpoint was not written; training continues"]


WRITE_AND_KILL = """
import json, os, signal, sys, time
from pathlib import Path
import torch
from athrl_learner.checkpoint import BestCheckpoint, CheckpointContent, remove_unneeded, write_checkpoint
from athrl_learner.log import LogPosition
folder = Path(sys.argv[1])
for delay in sys.argv[3:]:
    writer = os.fork()
    if writer == 0:
        number = 0
        while True:
            number += 1
            weights = {"weight": torch.full((1000, 1000), float(number))}
            agent = {"planner": weights, "priorities": {}}
            state = json.loads(sys.argv[2]) | {"number": number}
            write_checkpoint(folder, CheckpointContent(state, agent, LogPosition(1, 0, 0, 0, ())))
            remove_unneeded(folder, 2, BestCheckpoint(folder))
    while not list(folder.glob("checkpoint-[0-9]*[0-9]")):
        time.sleep(0.01)
    time.sleep(float(delay))
    os.kill(writer, signal.SIGKILL)
    os.waitpid(writer, 0)
    print("killed", flush=True)
    sys.stdin.readline()
"""


def test_a_kill_while_writing_leaves_a_loadable_checkpoint(tmp_path):
    delays = [str(delay / 1000) for delay in range(0, 96, 12)]
    unfinished = 0
    command = [sys.executable, "-c", WRITE_AND_KILL, str(tmp_path), json.dumps(content().state), *delays]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as killing:
        for _ in delays:
            assert killing.stdout.readline() == b"killed\n"
            _, used = newest_intact_checkpoint(tmp_path)
            assert torch.equal(
                used.agent["planner"]["weight"], torch.full((1000, 1000), float(used.state["number"]))
            )
            unfinished += len(remove_unfinished(tmp_path))
            killing.stdin.write(b"go on\n")
            killing.stdin.flush()
    assert unfinished > 0, "no kill met a checkpoint being written"
    assert not list(tmp_path.glob("*.part"))
