"""`run_learner`: one run of the learner, from locking its folder to its summary."""

from __future__ import annotations

import contextlib
import gc
import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from athrl_protocol import (
    PolicyPublisher,
    PolicyUpdate,
    RunFile,
    announce_presence,
    open_session,
    serve_run_file,
)
from athrl_protocol.announcements.address_file import address_announced, address_at
from athrl_protocol.announcements.answers import serve_changes
from athrl_protocol.transport.size_filter import largest_chunk_of

from athrl_learner.checkpoint.resume import checkpoint_to_resume
from athrl_learner.checkpoint.snapshot import saved_version
from athrl_learner.components import check_new_run, make_components
from athrl_learner.connections import connect
from athrl_learner.learner import Learner
from athrl_learner.publication import recorded_version
from athrl_learner.reporting.exposition import open_exposition
from athrl_learner.run_changes import replace_settings
from athrl_learner.run_folder import RunFolder
from athrl_learner.run_settings import NAME, checked_settings
from athrl_learner.training.device import log_device, training_device
from athrl_learner.training.memory import keep_freed_memory

log = logging.getLogger(__name__)

_SESSION_TIMEOUT = 10.0


@dataclass(frozen=True)
class Summary:
    """The result of a run."""

    run: str
    folder: Path
    finished: bool  # false: stopped before its end, can be resumed
    environment_steps: int
    updates: int
    samples_per_insert: float
    policy_version: int
    policy: Path  # the newest artefact
    seconds: float  # since this learner started


def run_learner(
    run_file: RunFile | None,
    *,
    resume: Path | None = None,
    stop: threading.Event,
    reached_as: str | None = None,
) -> Summary:
    """Run the learner, from the start or the newest checkpoint, until the run ends or `stop` is set.

    Listens at `network.listen` and `metrics.listen`, serves the run file, receives experience, trains,
    publishes and writes into the run's folder. At the end it stays for its actors (at most 10 s) and for an
    evaluator that is still working (at most 300 s). When `stop` is set it accepts no more chunks, writes a
    last checkpoint and returns. Calls `torch.set_num_threads` for the whole process.

    Args:
        run_file: the run to start; with `resume` the new settings, by default the run's own.
        resume: the folder of the run to resume.
        stop: set from a signal handler or another thread.
        reached_as: host name or address by which other machines reach this one; the learner's address is
            then kept in the run's folder while it runs.

    Raises:
        LearnerError: the folder is taken, in use, cannot be resumed, or the last checkpoint cannot be written
            there; or no planner matches the run file, or its policy is larger than actors accept; or this
            machine lacks the requested device or the memory for the replay, and nothing has been written; or
            training has diverged after the newest checkpoint.
        ProtocolError: an address is in use, `run.toml` is not valid, no client would accept the certificate,
            or a run that had certificates is resumed without them.
    """
    began = time.monotonic()
    run_file, path, address = _checked(run_file, resume)
    keep_freed_memory()
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(RunFolder(path))
        content = checkpoint_to_resume(folder, resuming=resume is not None)
        # The addresses before the folder's content: a run that cannot listen must leave nothing behind.
        session = stack.enter_context(
            open_session(
                listen=run_file.network.listen,
                timeout=_SESSION_TIMEOUT,
                run=run_file.run.name,
                certificates=run_file.network.certificates,
                largest_chunk=largest_chunk_of(run_file),
            )
        )
        exposition = open_exposition(stack, run_file)
        log_device(run_file)
        publisher = stack.enter_context(PolicyPublisher(session, run_file.run.name))
        components = make_components(stack, run_file, folder, content, publisher.publish)
        components.publication.resume_from(
            max(recorded_version(folder.latest_policy_facts), saved_version(content))
        )
        stack.enter_context(frozen_garbage_collector())
        # After everything is restored, so that no client gets an answer of an incomplete learner.
        connections = connect(stack, session, run_file, components, publisher, exposition)
        # The run's settings are only replaced by settings that fit the checkpoint.
        changes = replace_settings(
            folder, _with_address(run_file, address), components.store.environment_steps
        )
        stack.enter_context(serve_changes(session, run_file.run.name, changes))
        # Last, because a client with the run file expects everything else to be ready.
        stack.enter_context(serve_run_file(session, run_file))
        stack.enter_context(announce_presence(session, run_file.run.name, NAME, NAME))
        if reached_as is not None:
            stack.enter_context(address_announced(path, address_at(reached_as, address)))
        log.info("run %s listens at %s and writes into %s", run_file.run.name, address, path)
        finished = Learner(run_file, components, connections).run(stop)
    return Summary(
        run=run_file.run.name,
        folder=path,
        finished=finished,
        environment_steps=components.store.environment_steps,
        updates=components.trainer.updates,
        samples_per_insert=components.store.limiter.realised_ratio,
        policy_version=components.publication.version,
        policy=folder.latest_policy,
        seconds=time.monotonic() - began,
    )


def check_run(run_file: RunFile | None, *, resume: Path | None = None) -> str:
    """Check what `run_learner` checks before it listens; it neither listens nor trains.

    Returns:
        One line that says what a learner with these arguments would do.

    Raises:
        LearnerError, ProtocolError: as `run_learner`, but for an address that is in use.
    """
    run_file, path, _ = _checked(run_file, resume)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(RunFolder(path))
        content = checkpoint_to_resume(folder, resuming=resume is not None)
        if resume is None:
            check_new_run(run_file)
            return f"run {run_file.run.name} can start in {path}"
        components = make_components(stack, run_file, folder, content, deliver=_to_nobody)
        steps = components.store.environment_steps
        return f"run {run_file.run.name} can be resumed in {path}, from {steps} environment steps"


def _to_nobody(update: PolicyUpdate) -> None:
    """Deliver a policy where nobody is connected."""


def _checked(run_file: RunFile | None, resume: Path | None) -> tuple[RunFile, Path, str]:
    """The settings, the folder and the complete address of a run, checked before anything is written."""
    run_file, path, address = checked_settings(run_file, resume)
    training_device(run_file)
    return run_file, path, address


@contextlib.contextmanager
def frozen_garbage_collector() -> Iterator[None]:
    """Exclude existing objects, such as half a million of torch, from Python's garbage collection.

    A collection that includes them takes 0.2 s of a core, for which a snapshot or update would wait. A caller
    that has excluded its objects itself keeps them so.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _with_address(run_file: RunFile, address: str) -> RunFile:
    """The run file as it is stored: `tls/...` says that the run cannot be resumed without certificates."""
    network = run_file.network.model_copy(update={"listen": address})
    return run_file.model_copy(update={"network": network})
