"""Checkpoints: what is read is what was written, and a kill or a damaged disk costs the newest at most."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from athrl_learner.checkpoint import (
    CheckpointContent,
    newest_intact_checkpoint,
    read_checkpoint,
    remove_unfinished,
    write_checkpoint,
)
from athrl_learner.errors import CannotResume, CheckpointFailed, DamagedCheckpoint


def content(number: int = 0) -> CheckpointContent:
    return CheckpointContent(
        state={"number": number, "limiter": {"inserts": 3, "samples": 4}},
        agent={"updates": number, "levels": {"intention": {"weight": torch.full((3, 2), float(number))}}},
        replay={
            "images": np.random.default_rng(number).integers(0, 255, (7, 3, 8, 8, 4), dtype=np.uint8),
            "intention.rewards": np.linspace(0, 1, 6, dtype=np.float32).reshape(3, 2),
            "terminated": np.array([True, False]),
        },
    )


def test_a_checkpoint_holds_exactly_what_was_given(tmp_path):
    written = content(5)
    read = read_checkpoint(write_checkpoint(tmp_path, written, kept=3))
    assert read.state == written.state
    assert torch.equal(read.agent["levels"]["intention"]["weight"], torch.full((3, 2), 5.0))
    assert read.replay.keys() == written.replay.keys()
    for name, array in written.replay.items():
        np.testing.assert_array_equal(read.replay[name], array, strict=True)


def test_only_the_newest_are_kept(tmp_path):
    for number in range(5):
        write_checkpoint(tmp_path, content(number), kept=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint-000004", "checkpoint-000005"]
    _, newest = newest_intact_checkpoint(tmp_path)
    assert newest.state["number"] == 4


def test_a_folder_without_checkpoints_has_no_newest(tmp_path):
    assert newest_intact_checkpoint(tmp_path) is None
    assert newest_intact_checkpoint(tmp_path / "missing") is None


@pytest.mark.parametrize("name", ["agent.pt", "state.json", "replay/images.npy.zst", "manifest.json"])
@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_a_damaged_file_is_named_and_the_checkpoint_before_is_used(tmp_path, caplog, name, damage):
    older = write_checkpoint(tmp_path, content(1), kept=3)
    newest = write_checkpoint(tmp_path, content(2), kept=3)
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


def test_only_damaged_checkpoints_are_an_error_and_no_new_start(tmp_path):
    (write_checkpoint(tmp_path, content(), kept=3) / "agent.pt").write_bytes(b"")
    with pytest.raises(CannotResume, match="damaged"):
        newest_intact_checkpoint(tmp_path)


def test_a_pickle_with_the_right_checksum_is_refused(tmp_path):
    # A file that does something when it is unpickled, with a manifest made to fit it.
    written = content()
    path = write_checkpoint(tmp_path, CheckpointContent(written.state, {"threat": Threat()}, {}), kept=1)
    with pytest.raises(DamagedCheckpoint, match="cannot be read"):
        read_checkpoint(path)
    assert not Threat.carried_out


class Threat:
    carried_out = False

    def __reduce__(self):
        return (setattr, (Threat, "carried_out", True))


def test_another_format_is_refused_by_number(tmp_path):
    path = write_checkpoint(tmp_path, content(), kept=1)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps({**manifest, "format": 99}))
    with pytest.raises(CannotResume, match="format 99"):
        newest_intact_checkpoint(tmp_path)


def test_a_disk_that_refuses_leaves_the_checkpoints_before(tmp_path, monkeypatch):
    write_checkpoint(tmp_path, content(1), kept=3)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(CheckpointFailed, match="No space left"):
        write_checkpoint(tmp_path, content(2), kept=3)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-000001"]
    assert newest_intact_checkpoint(tmp_path)[1].state["number"] == 1


WRITE_AND_KILL = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
import torch
from athrl_learner.checkpoint import CheckpointContent, write_checkpoint
folder = Path(sys.argv[1])
images = np.random.default_rng(0).integers(0, 255, (2000, 32, 32, 4), dtype=np.uint8)
for delay in sys.argv[2:]:
    writer = os.fork()
    if writer == 0:
        number = 0
        while True:
            number += 1
            weights = {"weight": torch.full((1000, 1000), float(number))}
            content = CheckpointContent({"number": number}, weights, {"images": images})
            write_checkpoint(folder, content, kept=2)
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
    command = [sys.executable, "-c", WRITE_AND_KILL, str(tmp_path), *delays]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as killing:
        for _ in delays:
            assert killing.stdout.readline() == b"killed\n"
            _, used = newest_intact_checkpoint(tmp_path)
            assert torch.equal(used.agent["weight"], torch.full((1000, 1000), float(used.state["number"])))
            unfinished += len(remove_unfinished(tmp_path))
            killing.stdin.write(b"go on\n")
            killing.stdin.flush()
    assert unfinished > 0, "no kill met a checkpoint being written"
    assert not list(tmp_path.glob("*.part"))
