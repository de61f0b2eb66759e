"""The actor: drives environments with the run's newest policy and streams the experience to the learner.

Started with an address and a run's name, it asks the learner for the run file. While the learner is away it
keeps driving until as many chunks are unacknowledged as the run file allows, then waits, and continues when
the learner is back. The environments are made when the first policy arrives, which determines the kind of
action. Those that raise or stall are made again; an actor whose environments fail repeatedly exits. It ends
when the run is finished or `stop` is set, after it has sent the remaining chunks.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from contextlib import ExitStack

import zenoh
from athrl_driving.policy import EnvironmentFailure, GuardedBatch, environment_config, spread_towns
from athrl_protocol import (
    Chunk,
    ChunkUploader,
    FramePublisher,
    MetricsPublisher,
    Phase,
    PolicySubscriber,
    PolicyUpdate,
    StateSubscriber,
    join_run,
    new_incarnation,
)
from athrl_protocol.run_file import RunFile
from athrl_protocol.transport.session import certificate_hint
from athrl_spaces.wording import counted

from athrl_actor.acknowledgement_watch import AcknowledgementWatch
from athrl_actor.failures import FailureCount
from athrl_actor.frames import frame_of_moment
from athrl_actor.policy_lag import PolicyLag
from athrl_actor.progress import ProgressLog, progress_line
from athrl_actor.rollout import Moment, Rollout
from athrl_actor.seeds import ActorSeeds
from athrl_actor.warm_up import WarmUp

ROLE = "actor"
METRICS_SECONDS = 1.0
POLL_SECONDS = 0.2
# For sending the remaining chunks at the end. Zenoh closes a connection after five seconds without traffic,
# and until then all clients that share a router with a client that does not read may have to wait.
DRAIN_SECONDS = 8.0

log = logging.getLogger(__name__)


def run_actor(*, connect: str, run: str, name: str | None, stop: threading.Event, host: str = "") -> None:
    """Drive until the run is finished or `stop` is set.

    Without a name the learner gives one that is free, such as `actor-1`. `host` names this host and process.

    Raises ProtocolError when the learner or the run does not exist, another live actor has the name or a
    thread of this one fails, InvalidPolicy when the run's policy cannot be run, and TooManyFailures when the
    environments fail repeatedly; complete chunks have been sent by then.
    """
    with ExitStack() as stack:
        joined = join_run(role=ROLE, connect=connect, run=run, name=name, stop=stop, stack=stack, host=host)
        if joined is not None:
            Actor(joined.session, joined.run_file, joined.name, stop, stack).run()


class Actor:
    """An actor that has joined its run."""

    def __init__(
        self, session: zenoh.Session, run_file: RunFile, name: str, stop: threading.Event, stack: ExitStack
    ) -> None:
        """Open the connections; what must be closed, including the environments, is put on `stack`."""
        run, incarnation = run_file.run.name, new_incarnation()
        self._run_file = run_file
        self._stop = stop
        self._stack = stack
        self._policies = stack.enter_context(PolicySubscriber(session, run))
        self._states = stack.enter_context(StateSubscriber(session, run))
        self._rollout = Rollout(
            self._make_batch,
            run_file.actor.environments,
            ActorSeeds(run_file.run.seed, name, incarnation),
            actor=name,
            incarnation=incarnation,
            sequence_length=run_file.replay.sequence_length,
            sequences=run_file.longest_chunk // run_file.replay.sequence_length,
        )
        self._metrics = stack.enter_context(MetricsPublisher(session, run, ROLE, name))
        self._frames = stack.enter_context(FramePublisher(session, run, ROLE, name))
        self._uploader = stack.enter_context(
            ChunkUploader(
                session,
                run,
                name,
                incarnation,
                run_file.actor.unacknowledged_chunks,
                run_file.network.compression,
            )
        )
        self._pending: deque[Chunk] = deque()  # not yet taken by the uploader
        self._update: PolicyUpdate | None = None
        self._reported_at = time.monotonic()
        self._progress = ProgressLog()
        self._warn_at = time.monotonic() + run_file.network.patience
        self._certificate_hint = certificate_hint(session)
        self._delivery_seconds = 0.0  # from a policy's publication to its first use
        self._lag = PolicyLag(run_file.actor.policy_lag_versions, self._policies.ask)
        self._failures = FailureCount(run_file.actor.failures_allowed)
        self._warm_up = WarmUp(run_file.warm_up)

    def _make_batch(self, action_kind: str) -> GuardedBatch:
        batch = make_batch(self._run_file, action_kind)
        self._stack.callback(batch.close)
        return batch

    def run(self) -> None:
        """Drive to the end, then send the remaining chunks, also if driving ends with an error."""
        try:
            while not self._is_over():
                self._adopt_newest_policy()
                self._report()
                if not self._may_drive():
                    self._stop.wait(POLL_SECONDS)
                    self._warn_if_no_policy()
                elif self._has_driven_warm_up():
                    self._submit(self._rollout.flush())  # the learner trains when it has them
                    self._stop.wait(POLL_SECONDS)
                else:
                    self._submit(self._drive())
        finally:
            self._drain()

    def _warn_if_no_policy(self) -> None:
        """Warn once that no policy came; a run has one from its start, so the actor may not be allowed to."""
        if self._rollout.policy_version < 0 and time.monotonic() > self._warn_at:
            patience = self._run_file.network.patience
            log.warning("no policy has arrived for %g s%s", patience, self._certificate_hint)
            self._warn_at = math.inf

    def _may_drive(self) -> bool:
        """Whether there is a policy that is not too old."""
        version, state = self._rollout.policy_version, self._states.newest()
        return version >= 0 and self._lag.update(version, version if state is None else state.policy_version)

    def _has_driven_warm_up(self) -> bool:
        """Whether the policy is the random one, and the run has enough of its decisions."""
        if self._update is None or not self._update.uniform_exploration:
            return False
        uploads = self._uploader.statistics()
        self._warm_up.settled(uploads.acknowledged + uploads.given_up)
        return self._warm_up.is_driven(self._states.newest(), self._rollout.open_decisions)

    def _drive(self) -> list[Chunk]:
        """Make one decision in every environment; failed environments start new episodes."""
        try:
            return self._rollout.step(self._publish_frame if self._frames.watched else None)
        except EnvironmentFailure as failure:
            self._failures.add(failure, self._rollout.abandon(failure.env_indices))
            return []

    def _is_over(self) -> bool:
        """Whether to stop driving: a stop was requested, or the run is finished."""
        return self._stop.is_set() or self._finished()

    def _finished(self) -> bool:
        state = self._states.newest()
        return self._uploader.finished or (state is not None and state.phase is Phase.FINISHED)

    def _adopt_newest_policy(self) -> None:
        """Adopt the newest policy, between two decisions."""
        update = self._policies.newest()
        if update is None or update is self._update:
            return
        self._rollout.adopt(update)
        self._update = update
        self._delivery_seconds = max(0.0, time.time() - update.published_at)

    def _submit(self, chunks: list[Chunk]) -> None:
        """Give chunks to the uploader, waiting while it is full; chunks left at the end stay pending."""
        self._pending.extend(chunks)
        watch = None
        while self._pending:
            if self._uploader.submit(self._pending[0], timeout=POLL_SECONDS):
                self._warm_up.submitted(self._pending.popleft())
                continue
            if self._is_over():
                return
            self._report()
            # After an outage, resent chunks make no room for long although the learner acknowledges them.
            acknowledged = self._uploader.statistics().acknowledged
            watch = watch or AcknowledgementWatch(self._run_file.network.patience, acknowledged)
            overdue = watch.overdue_seconds(acknowledged)
            if overdue is not None:
                log.warning("the learner has accepted nothing for %.0f s; waiting for it", overdue)

    def _drain(self) -> None:
        """Send the open chunks, wait briefly for acknowledgements, and report on all chunks."""
        self._pending.extend(self._rollout.flush())
        try:
            self._deliver_remaining()
        finally:
            self._report_remaining()

    def _deliver_remaining(self) -> None:
        deadline = time.monotonic() + DRAIN_SECONDS
        while self._pending and not self._uploader.finished:
            if not self._uploader.submit(self._pending[0], timeout=max(0.0, deadline - time.monotonic())):
                break
            self._pending.popleft()
        self._uploader.flush(timeout=max(0.0, deadline - time.monotonic()))

    def _report_remaining(self) -> None:
        left = len(self._pending) + self._uploader.statistics().waiting
        if left and not self._uploader.finished:
            log.warning("%s not acknowledged within %.0f s", counted(left, "chunk"), DRAIN_SECONDS)
        self._uploader.give_up(len(self._pending))
        self._pending.clear()
        self._uploader.close()
        values = self._report_values()
        self._metrics.publish(values)
        log.info("%s: %s", "the run is finished" if self._finished() else "stopped", progress_line(values))

    def _report(self) -> None:
        """Publish metrics about once a second, and log the progress about once a minute."""
        if time.monotonic() - self._reported_at < METRICS_SECONDS:
            return
        self._reported_at = time.monotonic()
        values = self._report_values()
        self._metrics.publish(values)
        self._progress.report(values)

    def _report_values(self) -> dict[str, float]:
        uploads = self._uploader.statistics()
        self._warm_up.settled(uploads.acknowledged + uploads.given_up)
        values: dict[str, float] = {
            **self._rollout.statistics.report(),
            **self._failures.report(),
            "chunks_produced": uploads.produced,
            "chunks_acknowledged": uploads.acknowledged,
            "chunks_resent": uploads.resent,
            "chunks_turned_away": uploads.turned_away,
            "chunks_given_up": uploads.given_up,
            **{f"chunks_given_up/{reason}": count for reason, count in uploads.given_up_by_reason.items()},
            "chunks_waiting": uploads.waiting,
        }
        version = self._rollout.policy_version
        if version >= 0:
            values["policy_version"] = version
            values["policy_delivery_seconds"] = self._delivery_seconds
            values["policy_lag_seconds"] = self._lag.seconds
            values["policy_lag_versions"] = self._lag.versions
        return values

    def _publish_frame(self, moment: Moment) -> None:
        self._frames.publish(frame_of_moment(moment))


def make_batch(run_file: RunFile, action_kind: str) -> GuardedBatch:
    """The environments of an actor, in the run's towns by their shares."""
    settings, actor = run_file.environment.model_dump(), run_file.actor
    shares = settings.pop("towns")
    return GuardedBatch(
        spread_towns(shares, actor.environments),
        environment_config(**settings),
        action_kind,
        seconds=actor.stall_seconds,
        recorded=run_file.longest_chunk,
    )
