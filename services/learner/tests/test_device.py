"""Training happens on the device that the run file asks for, or the run does not begin."""

import logging
import os

import pytest
import torch
from athrl_learner import factories
from athrl_learner.errors import LearnerError
from athrl_learner.training import device
from athrl_learner.training.device import log_device, training_device, training_threads, update_precision
from athrl_planners.training.precision import Measured
from athrl_protocol import RunFile


def on(run_file: RunFile, place: str) -> RunFile:
    return run_file.model_copy(update={"learner": run_file.learner.model_copy(update={"device": place})})


@pytest.mark.parametrize(
    ("wanted", "there", "meant"),
    [
        ("cpu", True, "cpu"),
        ("cpu", False, "cpu"),
        ("auto", True, "cuda"),
        ("auto", False, "cpu"),
        ("cuda", True, "cuda"),
    ],
)
def test_device_is_the_one_that_is_meant(run_file, monkeypatch, caplog, wanted, there, meant):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    assert training_device(on(run_file, wanted)) == meant
    with caplog.at_level(logging.INFO):
        log_device(on(run_file, wanted))
    assert f"training on {meant}" in caplog.text
    assert ("learner.device is auto" in caplog.text) == (wanted == "auto")


def test_gpu_that_is_not_there_is_refused_in_one_line(run_file, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(
        LearnerError, match=r"^learner.device is cuda, .*: set learner.device to auto or cpu.*$"
    ):
        training_device(on(run_file, "cuda"))


def with_precision(run_file: RunFile, precision: str, *, serial: bool = False) -> RunFile:
    learner = run_file.learner.model_copy(update={"precision": precision})
    section = run_file.serial.model_copy(update={"enabled": serial})
    return run_file.model_copy(update={"learner": learner, "serial": section})


@pytest.mark.parametrize(("precision", "dtype"), [("float32", torch.float32), ("bfloat16", torch.bfloat16)])
def test_precision_is_the_one_that_is_wanted(run_file, caplog, precision, dtype):
    with caplog.at_level(logging.INFO):
        assert update_precision(with_precision(run_file, precision)) == dtype
    assert f"updates in {precision}, as learner.precision says, with " in caplog.text


@pytest.mark.parametrize(
    ("speed", "dtype", "said"),
    [
        (2.13, torch.bfloat16, "updates in bfloat16: bfloat16 is 2.1 times as fast as float32 here, with "),
        (0.4, torch.float32, "updates in float32: bfloat16 is 0.4 times as fast as float32 here, with "),
    ],
)
def test_faster_precision_is_taken_and_the_log_says_why(run_file, monkeypatch, caplog, speed, dtype, said):
    monkeypatch.setattr(device, "faster_precision", lambda _: Measured(dtype, speed))
    with caplog.at_level(logging.INFO):
        assert factories.make_agent(with_precision(run_file, "auto")).precision == dtype
    assert said in caplog.text


def test_measured_precision_is_one_of_the_two(run_file):
    assert update_precision(with_precision(run_file, "auto")) in (torch.float32, torch.bfloat16)


def test_serial_run_measures_nothing(run_file, monkeypatch, caplog):
    monkeypatch.delattr(device, "faster_precision")
    with caplog.at_level(logging.INFO):
        assert update_precision(with_precision(run_file, "auto", serial=True)) == torch.float32
    assert "updates in float32, since a serial run measures nothing" in caplog.text


def test_threads_are_those_of_the_run_file_or_one_for_each_core(run_file):
    cores = len(os.sched_getaffinity(0))
    for threads, expected in ((3, 3), (0, cores)):
        learner = run_file.learner.model_copy(update={"threads": threads})
        assert training_threads(run_file.model_copy(update={"learner": learner})) == expected
