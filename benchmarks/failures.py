"""Every collision and lane exit of a policy: where, with whom, and what led to it.

    python -m benchmarks.failures POLICY --episodes 300

drives held-out episodes greedily; started in the folder of the repository. POLICY is a file or a name of
`athrl policies`. It drives in `--town`, else in the towns of its run, else in town03; `--vehicles` gives
another number of vehicles. Each that ends by a collision or outside its lane gives a line: the seed,
so that it can be watched (`athrl evaluate --seed SEED --episodes 2 --record FOLDER`), time and place, the
nearest vehicle in the ego's frame, and the two seconds before: the ego's speed, the speed it wanted, and
where that vehicle was. The last line is one JSON object with the kinds of end.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter, deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from athrl.errors import CommandError, expected_errors
from athrl.evaluate.drivers import find_driver, run_file_of
from athrl.train.plan import require_world
from athrl_driving.policy import EnvironmentBatch, InvalidPolicy, OnnxPolicy, environment_config
from athrl_driving.scene import Scene, VehiclePose
from athrl_evaluator.policies.files import load_policy
from athrl_evaluator.scoring.environments import environment_for
from athrl_protocol.run_file import EnvironmentSection, read_run_file

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
    def rival(self) -> int | None:
        """The vehicle that is nearest in the end; None without vehicles."""
        ego, others = self.before[-1].ego, self.before[-1].vehicles
        return min(
            range(len(others)),
            key=lambda other: math.dist((ego.x, ego.y), (others[other].x, others[other].y)),
            default=None,
        )

    @property
    def kind(self) -> str:
        """What happened, in a few words."""
        rival = self.rival
        if not self.collided or rival is None:
            return "lane exit"
        ego, other = self.before[-1].ego, self.before[-1].vehicles[rival]
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


def _moment(scene: Scene, rival: int | None) -> str:
    wanted = "-" if scene.target_speed is None else f"{scene.target_speed:.1f}"
    own = f"{scene.ego.speed:.1f} ({wanted})"
    if rival is None:
        return own
    ahead, left = _in_frame(scene.ego, scene.vehicles[rival])
    return f"{own} other {ahead:.1f} ahead, {left:.1f} aside, {scene.vehicles[rival].speed:.1f}"


def _in_frame(ego: VehiclePose, other: VehiclePose) -> tuple[float, float]:
    east, north = other.x - ego.x, other.y - ego.y
    cosine, sine = math.cos(ego.heading), math.sin(ego.heading)
    return east * cosine + north * sine, north * cosine - east * sine


def named_policy(name: str) -> Path:
    """The file of a policy by its path or name; raises CommandError for another driver."""
    found = find_driver(name, option="")
    if isinstance(found, str):
        raise CommandError(f"{name}: drives without a policy, should be a policy's name or file")
    return found


def environment_of(policy: Path, town: str | None, vehicles: int | None) -> EnvironmentSection:
    """Where a policy drives: as in its run if it has one, but for what is given.

    Raises:
        CommandError, DrivingError: a town cannot be used, or has too little room.
    """
    own = run_file_of(policy)
    section = EnvironmentSection() if own is None else read_run_file(own, training=False).environment
    given = {"towns": None if town is None else {town: 1.0}, "vehicles": vehicles}
    section = section.model_copy(update={key: value for key, value in given.items() if value is not None})
    require_world(section)
    return section


def begun(
    policy: OnnxPolicy, town: str, seeds: list[int], section: EnvironmentSection | None = None
) -> EnvironmentBatch:
    """Environments as the policy needs them, each at the beginning of its seed's episode."""
    settings = environment_for(policy.description, section or EnvironmentSection()).model_dump()
    settings.pop("towns")
    kind = policy.description.action_kind
    batch = EnvironmentBatch([town] * len(seeds), environment_config(**settings), kind)
    for env_index, seed in enumerate(seeds):
        batch.reset(env_index, seed)
    return batch


def drive(
    policy: OnnxPolicy, town: str, seeds: list[int], section: EnvironmentSection
) -> tuple[list[End], list[float]]:
    """Drive an episode of each seed: those that ended too early, and all returns."""
    batch = begun(policy, town, seeds, section)
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


def failures(policy: OnnxPolicy, section: EnvironmentSection, seeds: list[int]) -> None:
    """Drive, and print the failures, those of each town after its name."""
    kinds: Counter[str] = Counter()
    returns: list[float] = []
    for town in section.towns:
        print(f"{town}, {section.vehicles} vehicles", flush=True)
        for start in range(0, len(seeds), TOGETHER):
            ends, some = drive(policy, town, seeds[start : start + TOGETHER], section)
            returns += some
            kinds.update(end.kind for end in ends)
            for end in ends:
                print(end.line(), flush=True)
    print(json.dumps({"episodes": len(returns), "return_mean": round(float(np.mean(returns)), 1), **kinds}))


def main() -> None:
    """Read the command line, and drive; what is wrong there is one line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policy", help="a file, or a name of `athrl policies`")
    parser.add_argument("--town", help="by default those of the policy's run, or town03")
    parser.add_argument("--vehicles", type=int, help="by default those of the policy's run, or 100")
    parser.add_argument("--episodes", type=int, default=300, help="in each town")
    parser.add_argument("--seed", type=int, default=700_000)
    arguments = parser.parse_args()
    try:
        path = named_policy(arguments.policy)
        policy = load_policy(path)
        section = environment_of(path, arguments.town, arguments.vehicles)
    except (*expected_errors(), InvalidPolicy, ValueError) as error:
        sys.exit(str(error))
    failures(policy, section, list(range(arguments.seed, arguments.seed + arguments.episodes)))


if __name__ == "__main__":
    main()
