"""Training happens on the device that the run file asks for, or the run does not begin."""

import logging

import pytest
import torch
from athrl_learner.device import log_device, training_device
from athrl_learner.errors import LearnerError
from athrl_protocol import RunFile


def on(run_file: RunFile, device: str) -> RunFile:
    return run_file.model_copy(update={"learner": run_file.learner.model_copy(update={"device": device})})


@pytest.mark.parametrize(
    ("wanted", "there", "device"),
    [
        ("cpu", True, "cpu"),
        ("cpu", False, "cpu"),
        ("auto", True, "cuda"),
        ("auto", False, "cpu"),
        ("cuda", True, "cuda"),
    ],
)
def test_device_is_the_one_that_is_meant(run_file, monkeypatch, caplog, wanted, there, device):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    assert training_device(on(run_file, wanted)) == device
    with caplog.at_level(logging.INFO):
        log_device(on(run_file, wanted))
    assert f"training on {device}" in caplog.text
    assert ("learner.device is auto" in caplog.text) == (wanted == "auto")


def test_gpu_that_is_not_there_is_refused_in_one_line(run_file, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(
        LearnerError, match=r"^learner.device is cuda, .*: set learner.device to auto or cpu.*$"
    ):
        training_device(on(run_file, "cuda"))
