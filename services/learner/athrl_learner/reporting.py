"""The run's state and the learner's metrics, once a second.

| metric | meaning |
|---|---|
| `environment_steps`, `environment_steps_per_second` | decisions accepted in the run, and their rate |
| `updates`, `updates_per_second` | updates of the planner in the run, and their rate |
| `update_seconds` | seconds spent in updates since the last report |
| `replay_transitions`, `replay_fill` | transitions in the replay, and the share of its places taken |
| `samples_per_insert` | how often a transition was drawn, on average, since the warm-up |
| `waiting/learner`, `waiting/actors` | share of the time between two reports that one waited for the other |
| `waiting/disk` | 1 while intake is paused because the disk is full |
| `policy_version`, `noise_scale` | the newest policy, and the factor on exploration noise |
| `policy_lag`, `policy_lag/NAME` | versions by which the actor's last chunk was behind; worst first |
| `transitions/NAME` | accepted from that actor since this learner started |
| `actors` | actors that are present |
| `intake/...` | chunks by what became of them, see `IntakeStatistics` |
| `loss/LEVEL/...` | means of what the updates since the last report said |
| `checkpoints_written`, `checkpoints_failed` | since this learner started |
| `log/bytes` | size of the log of experience |
| `log/recovered` | chunks that this learner took in from the log when it started, beyond the checkpoint |
| `log/damaged` | records of the log that could not be read, in the run |
"""

from __future__ import annotations

import time
from dataclasses import asdict

from athrl_protocol import ChunkIntake, MetricsPublisher, Phase, PresenceWatcher, RunState, StatePublisher

from athrl_learner.arrivals import Arrivals
from athrl_learner.checkpointing import Checkpointer
from athrl_learner.publication import Publication
from athrl_learner.store import ExperienceStore
from athrl_learner.training import Trainer

#: Seconds between two reports.
INTERVAL = 1.0


class Reporter:
    """Gathers what the parts count and publishes it."""

    def __init__(
        self,
        state_publisher: StatePublisher,
        metrics_publisher: MetricsPublisher,
        *,
        store: ExperienceStore,
        arrivals: Arrivals,
        trainer: Trainer,
        publication: Publication,
        checkpointer: Checkpointer,
        intake: ChunkIntake,
        presence: PresenceWatcher,
        recovered: int,
        damaged: int,
    ) -> None:
        self._state_publisher = state_publisher
        self._metrics_publisher = metrics_publisher
        self._store = store
        self._arrivals = arrivals
        self._trainer = trainer
        self._publication = publication
        self._checkpointer = checkpointer
        self._intake = intake
        self._presence = presence
        self._recovered = recovered
        self._damaged = damaged
        self._reported_at = time.monotonic()
        self._reported_steps = store.environment_steps
        self._reported_updates = trainer.updates
        self._ending: Phase | None = None

    @property
    def phase(self) -> Phase:
        """Where the run is."""
        if self._ending is not None:
            return self._ending
        return Phase.TRAINING if self._store.limiter.warmed_up else Phase.WARMING_UP

    def announce_end(self, phase: Phase) -> None:
        """Announce DRAINING or FINISHED at once; it stays."""
        self._ending = phase
        self.report()

    def report_if_due(self) -> None:
        """Report if a second has passed since the last report."""
        if time.monotonic() - self._reported_at >= INTERVAL:
            self.report()

    def report(self) -> None:
        """Publish state and metrics now."""
        with self._store.held():
            learner_share = self._store.learner_waiting.share()
            actors_share = self._store.actors_waiting.share()
            waiting = self._store.waiting_text()
            paused = bool(self._store.room.explain())
            arrivals = self._arrivals.metrics()
        self._state_publisher.publish(
            RunState(
                phase=self.phase,
                environment_steps=self._store.environment_steps,
                environment_steps_target=self._store.environment_steps_target,
                updates=self._trainer.updates,
                policy_version=self._publication.version,
                waiting="" if self._ending is not None else waiting,
            )
        )
        self._metrics_publisher.publish(
            {
                **self._counters(),
                **self._rates(),
                **arrivals,
                **self._trainer.metrics(),
                **self._intake_counts(),
                "waiting/learner": learner_share,
                "waiting/actors": actors_share,
                "waiting/disk": float(paused),
            }
        )

    def _counters(self) -> dict[str, float]:
        store, replay = self._store, self._store.replay
        return {
            "environment_steps": float(store.environment_steps),
            "updates": float(self._trainer.updates),
            "replay_transitions": float(len(replay)),
            "replay_fill": replay.sequences / replay.slots,
            "samples_per_insert": store.limiter.realised_ratio,
            "policy_version": float(self._publication.version),
            "noise_scale": self._publication.noise_scale,
            "checkpoints_written": float(self._checkpointer.written),
            "checkpoints_failed": float(self._checkpointer.failed),
            "log/bytes": float(store.log.size_bytes),
            "log/recovered": float(self._recovered),
            "log/damaged": float(self._damaged),
            "actors": float(sum(role == "actor" for role, _ in self._presence.present())),
        }

    def _rates(self) -> dict[str, float]:
        now = time.monotonic()
        elapsed = max(now - self._reported_at, 1e-6)
        steps = self._store.environment_steps - self._reported_steps
        updates = self._trainer.updates - self._reported_updates
        self._reported_at = now
        self._reported_steps += steps
        self._reported_updates += updates
        return {"environment_steps_per_second": steps / elapsed, "updates_per_second": updates / elapsed}

    def _intake_counts(self) -> dict[str, float]:
        statistics = asdict(self._intake.statistics())
        invalid = statistics.pop("invalid")
        by_sender = statistics.pop("invalid_by_sender")
        counts = {f"intake/{name}": float(value) for name, value in statistics.items()}
        counts["intake/invalid"] = float(sum(invalid.values()))
        counts |= {f"intake/invalid/{reason}": float(count) for reason, count in invalid.items()}
        for sender, reasons in by_sender.items():
            for reason, count in reasons.items():
                counts[f"intake/invalid/{reason}/{sender}"] = float(count)
        return counts
