"""`run_learner`: one run of the learner, from its folder's lock to its summary."""

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
    RunFile,
    announce_presence,
    complete_address,
    open_session,
    read_run_file,
    serve_run_file,
    to_toml,
)
from athrl_protocol.certificates import find_certificates
from athrl_protocol.limits import largest_chunk_of

from athrl_learner.connections import NAME, connect
from athrl_learner.device import log_device, training_device
from athrl_learner.errors import CannotResume
from athrl_learner.going_on import checkpoint_to_go_on_from
from athrl_learner.learner import Learner
from athrl_learner.memory import keep_freed_memory
from athrl_learner.parts import make_parts
from athrl_learner.planner_tables import held_to_planners, know_planners
from athrl_learner.publication import recorded_version
from athrl_learner.run_folder import RunFolder
from athrl_learner.snapshot import saved_version

log = logging.getLogger(__name__)

_SESSION_TIMEOUT = 10.0


@dataclass(frozen=True)
class Summary:
    """What a run came to."""

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
    evaluator_deadline: float = 300.0,
) -> Summary:
    """Be the learner of a run, from its start or its newest checkpoint, until it ends or `stop` is set.

    Listens at `network.listen`, serves the run file, takes experience in, trains, publishes and writes into
    the run's folder. At its end it stays for its actors (10 s at most) and for an evaluator that is still at
    work (`evaluator_deadline` at most). When `stop` is set it takes nothing more in, writes a last checkpoint
    and returns. Calls `torch.set_num_threads` for the whole process.

    Args:
        run_file: the run to start; with `resume` the settings to go on with, by default those it had.
        resume: the folder of the run to go on with.
        stop: set from a signal handler or another thread.
        evaluator_deadline: seconds.

    Raises:
        LearnerError: the folder is taken, in use, cannot be resumed, or does not take the last checkpoint; or
            there is no planner as the run file describes it; or this machine has no device of the kind that
            it asks for, or less memory than the replay would take, and nothing has been written; or training
            has diverged, which is a checkpoint later than the newest.
        ProtocolError: the address is in use, `run.toml` is wrong, no client would accept the certificate, or
            the run had certificates and is to go on without.
    """
    began = time.monotonic()
    run_file, path = _what_and_where(run_file, resume)
    if run_file.serial.enabled:
        raise CannotResume(f"{path} is a serial run, which has no learner of its own: athrl train --serial")
    shown = find_certificates(run_file.network.certificates, NAME)
    if shown is not None:
        shown.check_may_serve(NAME)
    elif resume is not None:  # a new run brings its own address
        complete_address(read_run_file(resume / "run.toml", complete=True).network.listen)
    address = complete_address(run_file.network.listen, secure=shown is not None)
    training_device(run_file)  # refused here: nothing has been written
    keep_freed_memory()
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(RunFolder(path))
        content = checkpoint_to_go_on_from(folder, resuming=resume is not None)
        # The address before the folder's content: a run that cannot listen leaves nothing behind.
        session = stack.enter_context(
            open_session(
                listen=run_file.network.listen,
                timeout=_SESSION_TIMEOUT,
                run=run_file.run.name,
                certificates=run_file.network.certificates,
                largest_chunk=largest_chunk_of(run_file),
            )
        )
        log_device(run_file)
        publisher = stack.enter_context(PolicyPublisher(session, run_file.run.name))
        parts = make_parts(stack, run_file, folder, content, publisher.publish)
        parts.publication.go_on(max(recorded_version(folder.latest_policy_facts), saved_version(content)))
        stack.enter_context(short_collections())
        # Not before everything is restored: who is answered is answered by a whole learner.
        connections = connect(stack, session, run_file, parts)
        # Only settings that the checkpoint fits replace those it was made with.
        folder.lay_out(to_toml(_with_address(run_file, address)))
        # Last, because a client with the run file expects everything else to be there.
        stack.enter_context(serve_run_file(session, run_file))
        stack.enter_context(announce_presence(session, run_file.run.name, NAME, NAME))
        log.info("run %s listens at %s and writes into %s", run_file.run.name, address, path)
        finished = Learner(run_file, parts, connections).run(stop, evaluator_deadline)
    return Summary(
        run=run_file.run.name,
        folder=path,
        finished=finished,
        environment_steps=parts.store.environment_steps,
        updates=parts.trainer.updates,
        samples_per_insert=parts.store.limiter.realised_ratio,
        policy_version=parts.publication.version,
        policy=folder.latest_policy,
        seconds=time.monotonic() - began,
    )


@contextlib.contextmanager
def short_collections() -> Iterator[None]:
    """Let Python's collector of cycles leave alone what is there now, such as torch's half a million objects.

    Looking through them takes 0.2 s of a core, and training would wait for it at some snapshot or update.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _with_address(run_file: RunFile, address: str) -> RunFile:
    """The run file as it is kept: a run that had certificates says `tls/...` and does not go on without."""
    network = run_file.network.model_copy(update={"listen": address})
    return run_file.model_copy(update={"network": network})


def _what_and_where(run_file: RunFile | None, resume: Path | None) -> tuple[RunFile, Path]:
    """The run file to follow and the run's folder."""
    know_planners()
    if resume is not None:
        if not (resume / "run.toml").is_file():
            raise CannotResume(f"{resume} holds no run to go on with: there is no run.toml in it")
        if run_file is None:
            return read_run_file(resume / "run.toml", complete=True), resume
        return held_to_planners(run_file), resume
    if run_file is None:
        raise ValueError("run_learner needs a run file, or a run to resume")
    return held_to_planners(run_file), Path(run_file.run.folder) / run_file.run.name
