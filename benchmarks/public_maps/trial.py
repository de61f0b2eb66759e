"""Loads a map and drives on it, or tells in one line why not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import athrl_driving
import gymnasium
import numpy as np
from athrl_driving.envs import TownEnv
from athrl_driving.inspection import MapFacts, facts_of, suggested_vehicles
from athrl_driving.maps import MapError, load_town

SECONDS = 20.0
FASTEST = 70.0
"""m/s that no vehicle reaches, whatever the file says."""

_BESIDE = 100.0
"""Metres beside the map's lanes where a vehicle may be at most."""
_VEHICLES = 50
_DECISION = 0.4


@dataclass(frozen=True)
class Trial:
    """What became of a map: either the line of its refusal, or its facts and how it was driven."""

    refusal: str = ""
    facts: MapFacts | None = None
    kilometres: float = 0.0
    """Of driving lanes in the file, those too that are too narrow to drive on."""
    vehicles: int = 0
    """In the background."""
    metres: float = 0.0
    """That the rule-based driver went."""
    collisions: int = 0


def try_map(path: Path, seed: int = 0) -> Trial:
    """Let the rule-based driver drive for 20 s, in one episode or, where it ends, in several.

    Raises `ArithmeticError` where a vehicle has no place or speed, or one that is beside the map or too fast.
    """
    try:
        town = load_town(path)
    except MapError as error:
        return Trial(refusal=str(error))
    vehicles = min(suggested_vehicles(town), _VEHICLES)
    env = gymnasium.make("athrl/OpenDrive-v0", map=str(path), config={"vehicles_count": vehicles})
    driver = athrl_driving.make_driver("rule-based")
    metres, collisions, ended = 0.0, 0, True
    for _ in range(round(SECONDS / _DECISION)):
        if ended:
            env.reset(seed=seed)
            driver.reset(env, seed)
            before = 0.0
        _, _, terminated, truncated, info = env.step(driver.act(env))
        _check_vehicles(env.unwrapped)
        ended = terminated or truncated
        metres += info["distance"] - before
        before, collisions = info["distance"], collisions + bool(info["collision"])
    env.close()
    return Trial(
        facts=facts_of(town),
        kilometres=town.lane_kilometres,
        vehicles=vehicles,
        metres=metres,
        collisions=collisions,
    )


def _check_vehicles(env: TownEnv) -> None:
    scene, box = env.scene(), env.town.graph.box
    vehicles = np.array([(one.x, one.y, one.speed) for one in (scene.ego, *scene.vehicles)])
    places, speeds = vehicles[:, :2], vehicles[:, 2]
    low, high = box[:, :2].min(axis=0) - _BESIDE, box[:, 2:].max(axis=0) + _BESIDE
    # Written so that what is no number fails too.
    if not ((places >= low) & (places <= high)).all() or not (np.abs(speeds) <= FASTEST).all():
        raise ArithmeticError(f"vehicles are at {places.tolist()}, at {speeds.tolist()} m/s")
