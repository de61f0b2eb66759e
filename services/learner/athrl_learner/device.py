"""Where training happens: what the run file asks for, if this machine has it."""

from __future__ import annotations

import logging

import torch
from athrl_protocol import RunFile

from athrl_learner.errors import NoSuchDevice

log = logging.getLogger(__name__)


def training_device(run_file: RunFile) -> str:
    """The device that `learner.device` means here: cpu or cuda.

    Raises:
        NoSuchDevice: it is to be a GPU, and torch finds none.
    """
    wanted = run_file.learner.device
    if wanted == "cpu" or torch.cuda.is_available():
        return "cpu" if wanted == "cpu" else "cuda"
    if wanted == "auto":
        return "cpu"
    raise NoSuchDevice(
        f"learner.device is cuda, and torch {torch.__version__} {_why_none()}: "
        "set learner.device to auto or cpu, or train where there is a GPU"
    )


def log_device(run_file: RunFile) -> None:
    """Say where training will happen; raises as `training_device` does."""
    device = training_device(run_file)
    if run_file.learner.device != "auto":
        log.info("training on %s", device)
    elif device == "cpu":
        log.info("training on cpu: learner.device is auto, and torch %s", _why_none())
    else:
        log.info("training on cuda: learner.device is auto, and there is a GPU")


def _why_none() -> str:
    return "is built without CUDA" if torch.version.cuda is None else "finds no CUDA device here"
