"""Serial runs in this process, and whether two of them ended as the same."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from athrl.serial.session import run_serial
from athrl_learner import factories
from athrl_learner.checkpoint import newest_intact_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_protocol.run_file import RunFile, read_run_file


@contextlib.contextmanager
def torch_left_as_it_was() -> Iterator[None]:
    """Serial runs in this process change torch for the whole of it."""
    threads = torch.get_num_threads()
    yield
    torch.set_deterministic_debug_mode("default")
    torch.set_num_threads(threads)


def drive_serially(
    folder: Path, name: str, settings: Iterable[str], *, resume: bool = False, stop_at: int | None = None
) -> bool:
    """Drive a run in this process, new or resumed; return whether it reached its end."""
    run_file = read_run_file(None, [*settings, f"run.folder={folder}", f"run.name={name}"])
    return run_serial(run_file, resume=resume, stop=threading.Event(), stop_at=stop_at)


def everything(folder: Path) -> dict[str, Any]:
    """All that a run ended with: its newest checkpoint, the replay's arrays, the files beside it."""
    found = newest_intact_checkpoint(folder / "checkpoints")
    assert found is not None
    _, content = found
    run_file: RunFile = read_run_file(folder / "run.toml", complete=True)
    agent = factories.make_agent(run_file)
    store = make_experience(run_file, agent, Arrivals(), factories.make_log(run_file, folder / "experience"))
    restore_snapshot(content, agent, store, "repeated")
    return {
        "state": {name: value for name, value in content.state.items() if name != "run_file"},
        "agent": content.agent,
        "actor": content.actor,
        "records": [content.log.next_record, content.log.oldest],
        "replay": store.replay.columns(),
        "policy": (folder / "policies" / "latest.onnx").read_bytes(),
        "trace": (folder / "trace.txt").read_text(),
        "scores": (folder / "evaluations.jsonl").read_text(),
        "comparison": json.loads((folder / "evaluation.json").read_text())["drivers"],
    }


def require_equal(ours: Any, theirs: Any, where: str = "") -> None:
    """Compare bit for bit, and name what differs."""
    assert type(ours) is type(theirs), where
    if isinstance(ours, dict):
        assert list(ours) == list(theirs), where
        for name in ours:
            require_equal(ours[name], theirs[name], f"{where}.{name}")
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(theirs), where
        for index, (our, their) in enumerate(zip(ours, theirs, strict=True)):
            require_equal(our, their, f"{where}[{index}]")
    elif isinstance(ours, torch.Tensor):
        require_equal(ours.numpy(), theirs.numpy(), where)
    elif isinstance(ours, np.ndarray):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape), where
        assert ours.tobytes() == theirs.tobytes(), where
    else:
        assert ours == theirs, where
