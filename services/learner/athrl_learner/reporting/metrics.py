"""The run's state, and the learner's metrics; `athrl_protocol.monitoring.table` says what each means."""

from __future__ import annotations

from athrl_protocol import Phase, RunState
from athrl_protocol.announcements.recent_rate import RecentRate

from athrl_learner.components import Components


class LearnerMetrics:
    """Collects the counts of a learner's components."""

    def __init__(self, components: Components) -> None:
        self._components = components
        self._steps_rate, self._updates_rate = RecentRate(), RecentRate()
        self._warmed_up = components.store.limiter.warmed_up
        self._note_progress()

    def state(self, ending: Phase | None = None) -> RunState:
        """The state of the run; at its end `ending` is the phase, and nothing waits any more."""
        store = self._components.store
        with store.held():
            waiting = store.waiting_text()
        driving = Phase.TRAINING if store.limiter.warmed_up else Phase.WARMING_UP
        return RunState(
            phase=driving if ending is None else ending,
            environment_steps=store.environment_steps,
            environment_steps_target=store.environment_steps_target,
            updates=self._components.trainer.updates,
            policy_version=self._components.publication.version,
            waiting="" if ending is not None else waiting,
        )

    def metrics(self) -> dict[str, float]:
        """All metrics but those of the network; shares and losses are since the last call."""
        store = self._components.store
        with store.held():
            waiting = {
                "waiting/learner": store.learner_waiting.share(),
                "waiting/actors": store.actors_waiting.share(),
                "waiting/disk": float(bool(store.disk_space.explain())),
            }
            arrivals = self._components.arrivals.metrics()
        return {
            **self._counters(),
            **self._rates(),
            **self._disk(),
            **arrivals,
            **self._components.trainer.metrics(),
            **waiting,
        }

    def _counters(self) -> dict[str, float]:
        components, store, replay = self._components, self._components.store, self._components.store.replay
        return {
            "environment_steps": float(store.environment_steps),
            "environment_steps_target": float(store.environment_steps_target),
            "updates": float(components.trainer.updates),
            "replay_transitions": float(len(replay)),
            "replay_fill": replay.sequences / replay.slots,
            "samples_per_insert": store.limiter.realised_ratio,
            "policy_version": float(components.publication.version),
            "noise_scale": components.publication.noise_scale,
            "unpublished_policy": float(components.arrivals.unpublished),
            "checkpoints_written": float(components.checkpointer.written),
            "checkpoints_failed": float(components.checkpointer.failed),
            "log/bytes": float(store.log.size_bytes),
            "log/recovered": float(components.recovered),
            "log/damaged": float(components.damaged),
        }

    def _disk(self) -> dict[str, float]:
        free = self._components.store.log.free_bytes()
        reserved = {"disk/reserved_bytes": float(self._components.store.log.reserve_bytes)}
        return reserved if free is None else {**reserved, "disk/free_bytes": float(free)}

    def _rates(self) -> dict[str, float]:
        self._note_progress()
        return {
            "environment_steps_per_second": self._steps_rate.per_second() or 0.0,
            "updates_per_second": self._updates_rate.per_second() or 0.0,
        }

    def _note_progress(self) -> None:
        warmed_up = self._components.store.limiter.warmed_up
        if warmed_up != self._warmed_up:  # driving was many times faster before
            self._warmed_up = warmed_up
            self._steps_rate.restart()
        self._steps_rate.note(self._components.store.environment_steps)
        self._updates_rate.note(self._components.trainer.updates)
