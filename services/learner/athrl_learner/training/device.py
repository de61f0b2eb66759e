"""The device of training: what the run file asks for, if this machine has it."""

from __future__ import annotations

import logging
import os

import torch
from athrl_planners import Agent
from athrl_planners.training.precision import faster_precision
from athrl_protocol import RunFile
from athrl_spaces.wording import counted

from athrl_learner.errors import NoSuchDevice

log = logging.getLogger(__name__)


def training_device(run_file: RunFile) -> str:
    """The device that `learner.device` means here: cpu or cuda.

    Raises:
        NoSuchDevice: it should be a GPU, and torch finds none.
    """
    wanted = run_file.learner.device
    if wanted == "cpu" or torch.cuda.is_available():
        return "cpu" if wanted == "cpu" else "cuda"
    if wanted == "auto":
        return "cpu"
    raise NoSuchDevice(
        f"learner.device is cuda, and torch {torch.__version__} {_why_none()}: "
        "set learner.device to auto or cpu, or train on a machine with a GPU"
    )


def training_threads(run_file: RunFile) -> int:
    """Number of training threads: that of the run file, or one for each core of this process.

    A serial run has one by default, so that it is the same on every machine.
    """
    fitting = 1 if run_file.serial.enabled else len(os.sched_getaffinity(0))
    return run_file.learner.threads or fitting


def share_threads(run_file: RunFile, agent: Agent) -> None:
    """Let the threads compute parts of an update in parallel, or let torch use them within operations."""
    torch.set_num_threads(training_threads(run_file) if agent.has_memory else 1)


def update_precision(run_file: RunFile) -> torch.dtype:
    """The precision of updates on this machine; logs it with the reason.

    A serial run does not measure time, so `auto` is float32 there.
    """
    wanted, threads = run_file.learner.precision, f"with {counted(training_threads(run_file), 'thread')}"
    if wanted != "auto":
        log.info("updates in %s, as learner.precision says, %s", wanted, threads)
        return torch.bfloat16 if wanted == "bfloat16" else torch.float32
    if run_file.serial.enabled:
        log.info("updates in float32, since a serial run measures nothing, %s", threads)
        return torch.float32
    device = training_device(run_file)
    precision, speed = faster_precision(torch.device(device))
    name = str(precision).removeprefix("torch.")
    if device == "cpu":
        log.info("updates in %s: bfloat16 is %.1f times as fast as float32 here, %s", name, speed, threads)
    else:
        log.info("updates in %s, which is the fastest that this GPU has", name)
    return precision


def log_device(run_file: RunFile) -> None:
    """Log the device of training; raises as `training_device` does."""
    device = training_device(run_file)
    if run_file.learner.device != "auto":
        log.info("training on %s", device)
    elif device == "cpu":
        log.info("training on cpu: learner.device is auto, and torch %s", _why_none())
    else:
        log.info("training on cuda: learner.device is auto, and there is a GPU")


def _why_none() -> str:
    return "is built without CUDA" if torch.version.cuda is None else "finds no CUDA device here"
