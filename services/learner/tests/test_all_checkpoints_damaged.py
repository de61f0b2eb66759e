"""If all checkpoints of a run are damaged, there is an error and nothing is changed."""

import hashlib
import shutil
import threading
from pathlib import Path

import pytest
from athrl_learner import CannotResume, run_learner


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def stopped() -> threading.Event:
    stop = threading.Event()
    stop.set()
    return stop


def test_run_without_a_whole_checkpoint_is_refused_by_name_and_nothing_changes(run_file, stopped):
    folder = run_learner(run_file, stop=stopped).folder
    run_learner(None, resume=folder, stop=stopped)
    checkpoints = sorted((folder / "checkpoints").glob("checkpoint-??????"))
    assert len(checkpoints) == 2
    for path in checkpoints:
        (path / "agent.pt").write_bytes(b"not what was written")
    before = contents(folder)
    with pytest.raises(CannotResume) as refusal:
        run_learner(None, resume=folder, stop=stopped)
    line = str(refusal.value)
    assert "\n" not in line
    for told in (str(checkpoints[-1] / "agent.pt"), "run.name", str(folder / "experience"), "nothing was"):
        assert told in line, line
    assert contents(folder) == before


def test_run_whose_damaged_checkpoints_are_removed_trains_anew(run_file, stopped):
    folder = run_learner(run_file, stop=stopped).folder
    (next((folder / "checkpoints").glob("checkpoint-*")) / "manifest.json").write_bytes(b"{}")
    with pytest.raises(CannotResume, match="remove"):
        run_learner(None, resume=folder, stop=stopped)
    shutil.rmtree(folder / "checkpoints")
    assert run_learner(None, resume=folder, stop=stopped).updates == 0
