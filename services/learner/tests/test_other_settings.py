"""Who resumes a run with settings that its checkpoint does not fit is told which."""

import threading

import pytest
from athrl_learner import CannotResume, run_learner


def test_setting_that_the_checkpoint_does_not_fit_is_named_with_both_values(run_file):
    stopped = threading.Event()
    stopped.set()
    folder = run_learner(run_file, stop=stopped).folder
    before = run_file.planner.recurrent_features
    planner = run_file.planner.model_copy(update={"recurrent_features": before + 4})
    larger = run_file.model_copy(update={"planner": planner})
    with pytest.raises(CannotResume, match="does not fit the run's settings") as refusal:
        run_learner(larger, resume=folder, stop=stopped)
    line = str(refusal.value)
    assert line.endswith(f"; planner.recurrent_features was {before} and is {before + 4}")
    assert "\n" not in line
