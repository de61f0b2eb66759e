"""Every collision and lane exit of a policy: where, with whom, and what led to it.

    python -m benchmarks.failures POLICY.onnx --episodes 300

drives held-out episodes greedily. Each that ends by a collision or outside its lane gives a line: the seed,
so that it can be watched (`athrl evaluate --seed SEED --episodes 2 --record FOLDER`), time and place, the
nearest vehicle in the ego's frame, and the two seconds before: the ego's speed, the speed it wanted, and
where that vehicle was. The last line is one JSON object with the kinds of end.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter, deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from athrl_driving.policy import EnvironmentBatch, OnnxPolicy, environment_config
from athrl_driving.scene import Scene, VehiclePose
from athrl_evaluator.scoring.environments import environment_for
from athrl_protocol.run_file import EnvironmentSection

TOGETHER = 50  # environments
REMEMBERED = 5  # decisions of 0.4 s: two seconds
STANDS = 0.5  # m/s


@dataclass(frozen=True)
class End:
    """An episode that ended too early; `before` are the moments that led to it, the last one is the end."""

    seed: int
    collided: bool
    before: list[Scene]

    @property
    def rival(self) -> int:
        """The vehicle that is nearest in the end."""
        ego, others = self.before[-1].ego, self.before[-1].vehicles
        return min(
            range(len(others)),
            key=lambda other: math.dist((ego.x, ego.y), (others[other].x, others[other].y)),
        )

    @property
    def kind(self) -> str:
        """What happened, in a few words."""
        if not self.collided:
            return "lane exit"
        ego, other = self.before[-1].ego, self.before[-1].vehicles[self.rival]
        turned = abs(math.degrees(math.remainder(other.heading - ego.heading, math.tau)))
        where = "same direction" if turned < 30 else "oncoming" if turned > 150 else "crossing"
        return f"{where}, {'at less than' if ego.speed < STANDS else 'above'} {STANDS:g} m/s"

    def line(self) -> str:
        """All of it in one line."""
        scene, rival = self.before[-1], self.rival
        path = "; ".join(_moment(moment, rival) for moment in self.before)
        return (
            f"seed {self.seed}, {scene.time:.1f} s, at ({scene.ego.x:.0f}, {scene.ego.y:.0f}): {self.kind}; "
            f"speed (wanted), the other's place and speed: {path}"
        )


def _moment(scene: Scene, rival: int) -> str:
    ahead, left = _in_frame(scene.ego, scene.vehicles[rival])
    wanted = "-" if scene.target_speed is None else f"{scene.target_speed:.1f}"
    return (
        f"{scene.ego.speed:.1f} ({wanted}) other {ahead:.1f} ahead, {left:.1f} aside, "
        f"{scene.vehicles[rival].speed:.1f}"
    )


def _in_frame(ego: VehiclePose, other: VehiclePose) -> tuple[float, float]:
    east, north = other.x - ego.x, other.y - ego.y
    cosine, sine = math.cos(ego.heading), math.sin(ego.heading)
    return east * cosine + north * sine, north * cosine - east * sine


def begun(policy: OnnxPolicy, town: str, seeds: list[int]) -> EnvironmentBatch:
    """Environments as the policy needs them, each at the beginning of its seed's episode."""
    section = environment_for(policy.description, EnvironmentSection()).model_dump()
    section.pop("towns")
    kind = policy.description.action_kind
    batch = EnvironmentBatch([town] * len(seeds), environment_config(**section), kind)
    for env_index, seed in enumerate(seeds):
        batch.reset(env_index, seed)
    return batch


def drive(policy: OnnxPolicy, town: str, seeds: list[int]) -> tuple[list[End], list[float]]:
    """Drive an episode of each seed: those that ended too early, and all returns."""
    batch = begun(policy, town, seeds)
    scenes: list[deque[Scene]] = [deque(maxlen=REMEMBERED) for _ in seeds]
    states, driving = policy.initial_states(len(seeds)), np.ones(len(seeds), np.bool_)
    returns, ends = np.zeros(len(seeds)), []
    while driving.any():
        for env_index in np.flatnonzero(driving):
            scenes[env_index].append(batch.environments[env_index].scene())
        step = policy.step(batch.images, batch.motion, states)
        states = step.states
        result = batch.step(policy.description.environment_action(step.actions), driving)
        returns += result.rewards
        for env_index in np.flatnonzero(result.terminated):
            before = [*scenes[env_index], batch.environments[env_index].scene()]
            ends.append(End(seeds[env_index], bool(batch.info(env_index)["collision"]), before))
        driving &= ~(result.terminated | result.truncated)
    batch.close()
    return ends, returns.tolist()


def main() -> None:
    """Drive, and print the failures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policy", type=Path)
    parser.add_argument("--town", default="town03")
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=700_000)
    arguments = parser.parse_args()
    policy = OnnxPolicy.load(arguments.policy)
    seeds = list(range(arguments.seed, arguments.seed + arguments.episodes))
    kinds: Counter[str] = Counter()
    returns: list[float] = []
    for start in range(0, len(seeds), TOGETHER):
        ends, some = drive(policy, arguments.town, seeds[start : start + TOGETHER])
        returns += some
        kinds.update(end.kind for end in ends)
        for end in ends:
            print(end.line(), flush=True)
    print(json.dumps({"episodes": len(seeds), "return_mean": round(float(np.mean(returns)), 1), **kinds}))


if __name__ == "__main__":
    main()
