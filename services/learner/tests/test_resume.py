"""A checkpoint can only be resumed by the kind of run that wrote it."""

import dataclasses

import pytest
import torch
from athrl_learner import CannotResume
from athrl_learner.checkpoint import CheckpointContent, write_checkpoint
from athrl_learner.checkpoint.resume import checkpoint_to_resume
from athrl_learner.log import LogPosition
from athrl_learner.run_folder import RunFolder

STATE = {
    "run_file": {},
    "environment_steps": 5,
    "updates": 4,
    "policy_version": 3,
    "limiter": {"inserts": 5, "samples": 0},
    "ledger": {},
    "totals": {},
    "replay": {"inserted": 0, "sequences": 0, "random": []},
    "policy": "",
}
DISTRIBUTED = CheckpointContent(
    STATE, {"planner": {"weight": torch.zeros(1)}, "priorities": {}}, LogPosition(1, 0, 0, 0, ())
)
SERIAL = dataclasses.replace(DISTRIBUTED, actor={"steps": [1]})


@pytest.mark.parametrize(("content", "serial"), [(DISTRIBUTED, False), (SERIAL, True)])
def test_checkpoint_of_the_same_kind_is_gone_on_from(tmp_path, content, serial):
    write_checkpoint(tmp_path / "checkpoints", content)
    with RunFolder(tmp_path) as folder:
        found = checkpoint_to_resume(folder, resuming=True, serial=serial)
    assert found is not None
    assert found.actor == content.actor


@pytest.mark.parametrize(
    ("content", "serial", "said"),
    [(DISTRIBUTED, True, "of a distributed run.*without --serial"), (SERIAL, False, "of a serial run")],
)
def test_checkpoint_of_the_other_kind_is_refused_by_name(tmp_path, content, serial, said):
    path = write_checkpoint(tmp_path / "checkpoints", content)
    with RunFolder(tmp_path) as folder, pytest.raises(CannotResume, match=said) as refusal:
        checkpoint_to_resume(folder, resuming=True, serial=serial)
    assert str(path) in str(refusal.value)


def test_run_without_a_checkpoint_begins_anew(tmp_path):
    with RunFolder(tmp_path) as folder:
        assert checkpoint_to_resume(folder, resuming=True, serial=True) is None
