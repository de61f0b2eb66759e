"""The run's state, and the learner's metrics.

| metric | meaning |
|---|---|
| `environment_steps`, `environment_steps_per_second` | decisions accepted in the run, and their rate |
| `updates`, `updates_per_second` | updates of the planner in the run, and their rate |
| `update_seconds` | seconds spent in updates since the last report |
| `trained_per_second` | decisions trained in a second of these, repeats counted, padding not |
| `replay_transitions`, `replay_fill` | transitions in the replay, and the share of its places taken |
| `samples_per_insert` | how often a transition was drawn, on average, since the warm-up |
| `waiting/learner`, `waiting/actors` | share of the time between two reports that one waited for the other |
| `waiting/disk` | 1 while intake is paused because the disk is full |
| `policy_version`, `noise_scale` | the newest policy, and the factor on exploration noise |
| `policy_lag`, `policy_lag/NAME` | versions by which the actor's last chunk was behind; worst first |
| `policy_lag_seconds`, `policy_lag_seconds/NAME` | seconds since there was a newer policy than that chunk's |
| `transitions/NAME` | accepted from that actor since this learner started |
| `loss/LEVEL/critic_loss`, `td_error`, `value` | a level's critics: loss, mean absolute error, mean value |
| `loss/LEVEL/actor_loss`, `saturated` | its actor: loss, share of outputs beyond +-2 before the tanh |
| `loss/critic_gradient`, `loss/actor_gradient` | norms of all levels' gradients before clipping |
| `checkpoints_written`, `checkpoints_failed` | since this learner started |
| `log/bytes` | size of the log of experience |
| `log/recovered` | chunks that this learner took in from the log when it started, beyond the checkpoint |
| `log/damaged` | records of the log that could not be read, in the run |
"""

from __future__ import annotations

import time

from athrl_protocol import Phase, RunState

from athrl_learner.parts import Parts


class Figures:
    """Gathers what a learner's parts count."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._told_at = time.monotonic()
        self._told_steps = parts.store.environment_steps
        self._told_updates = parts.trainer.updates

    def state(self, ending: Phase | None = None) -> RunState:
        """Where the run is; at its end `ending` says so, and nobody waits any more."""
        store = self._parts.store
        with store.held():
            waiting = store.waiting_text()
        driving = Phase.TRAINING if store.limiter.warmed_up else Phase.WARMING_UP
        return RunState(
            phase=driving if ending is None else ending,
            environment_steps=store.environment_steps,
            environment_steps_target=store.environment_steps_target,
            updates=self._parts.trainer.updates,
            policy_version=self._parts.publication.version,
            waiting="" if ending is not None else waiting,
        )

    def metrics(self) -> dict[str, float]:
        """Everything that the table above names; rates, shares and losses are since the last call."""
        store = self._parts.store
        with store.held():
            waiting = {
                "waiting/learner": store.learner_waiting.share(),
                "waiting/actors": store.actors_waiting.share(),
                "waiting/disk": float(bool(store.room.explain())),
            }
            arrivals = self._parts.arrivals.metrics()
        return {**self._counters(), **self._rates(), **arrivals, **self._parts.trainer.metrics(), **waiting}

    def _counters(self) -> dict[str, float]:
        parts, store, replay = self._parts, self._parts.store, self._parts.store.replay
        return {
            "environment_steps": float(store.environment_steps),
            "updates": float(parts.trainer.updates),
            "replay_transitions": float(len(replay)),
            "replay_fill": replay.sequences / replay.slots,
            "samples_per_insert": store.limiter.realised_ratio,
            "policy_version": float(parts.publication.version),
            "noise_scale": parts.publication.noise_scale,
            "checkpoints_written": float(parts.checkpointer.written),
            "checkpoints_failed": float(parts.checkpointer.failed),
            "log/bytes": float(store.log.size_bytes),
            "log/recovered": float(parts.recovered),
            "log/damaged": float(parts.damaged),
        }

    def _rates(self) -> dict[str, float]:
        now = time.monotonic()
        elapsed = max(now - self._told_at, 1e-6)
        steps = self._parts.store.environment_steps - self._told_steps
        updates = self._parts.trainer.updates - self._told_updates
        self._told_at = now
        self._told_steps += steps
        self._told_updates += updates
        return {"environment_steps_per_second": steps / elapsed, "updates_per_second": updates / elapsed}
