"""How many decisions an actor drives in a CPU second, beside the same decisions in stock highway-env.

An actor's driving is what the default run file says: its environments of town03 with 100 vehicles, four
ticks a decision, bird's eye view and lidar, and an untrained policy in ONNX Runtime, which takes as long as a
trained one. The same decisions in stock highway-env are four frames of a `RegulatedRoad` over the same lanes
with as many vehicles, and neither observation nor policy: what they would really cost is more, so the ratio
is the least that a training run's driving gains. Both in CPU seconds of one process.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings

import numpy as np
from athrl.runs import declare_installed_planners
from athrl_driving.policy import EnvironmentBatch, OnnxPolicy, environment_config, spread_towns
from athrl_learner import factories
from athrl_planners import PolicyExporter
from athrl_protocol import RunFile, read_run_file

from benchmarks.traffic import RULES_EVERY, run, town_road


class Driving:
    """The environments of one actor, driven by a policy that nothing was trained for."""

    def __init__(self, run_file: RunFile) -> None:
        settings = run_file.environment.model_dump()
        shares, count = settings.pop("towns"), run_file.actor.environments
        self._policy = OnnxPolicy(PolicyExporter(factories.make_agent(run_file)).artefact())
        self._batch = EnvironmentBatch(
            spread_towns(shares, count),
            environment_config(**settings),
            self._policy.description.action_kind,
        )
        self._states = self._policy.initial_states(count)
        self._seed = 0
        for env_index in range(count):
            self._begin(env_index)

    def decide(self) -> int:
        """Make a decision in each environment and reset those that ended; return how many were made."""
        step = self._policy.step(self._batch.images, self._batch.motion, self._states)
        self._states = {name: states.copy() for name, states in step.states.items()}
        outcome = self._batch.step(self._policy.description.environment_action(step.actions))
        for env_index in np.flatnonzero(outcome.terminated | outcome.truncated).tolist():
            self._begin(env_index)
        return len(self._batch)

    def _begin(self, env_index: int) -> None:
        self._batch.reset(env_index, self._seed)
        self._seed += 1
        for states in self._states.values():
            states[env_index] = 0.0


def actor_rate(run_file: RunFile, seconds: float) -> float:
    """Decisions a CPU second of driving, perception and policy."""
    driving = Driving(run_file)
    driving.decide()
    decisions, began = 0, time.process_time()
    while time.process_time() - began < seconds:
        decisions += driving.decide()
    return decisions / (time.process_time() - began)


def stock_rate(run_file: RunFile) -> float:
    """Decisions a CPU second of stock highway-env's traffic, over whole rounds of its rules."""
    environment = run_file.environment
    road = town_road(next(iter(environment.towns)), environment.vehicles, regulated=True)
    frames = RULES_EVERY * environment.ticks_per_decision
    return RULES_EVERY / sum(run(road) for _ in range(frames))


def main() -> None:
    """Measure and print; the last line is one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of the actor's driving")
    parser.add_argument("--set", action="append", default=[], help="settings of the run file")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    declare_installed_planners()
    run_file = read_run_file(None, arguments.set)
    stock, actor = stock_rate(run_file), actor_rate(run_file, arguments.seconds)
    figures = {
        "stock_traffic_decisions_per_second": round(stock, 3),
        "actor_decisions_per_second": round(actor, 1),
        "driving_ratio": round(actor / stock, 1),
    }
    for name, value in figures.items():
        print(f"{name:42} {value:12,.1f}")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
