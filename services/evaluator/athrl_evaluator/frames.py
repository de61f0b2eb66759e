"""A moment of an evaluated episode as the message that is shown live and recorded."""

from __future__ import annotations

import numpy as np
from athrl_driving import Scene
from athrl_protocol import Frame

from athrl_evaluator.drivers import BatchDriver
from athrl_evaluator.episodes import EpisodeStep


def frame_of(driver: BatchDriver, town: str, step: EpisodeStep) -> Frame:
    """Describe the moment after a step."""
    scene: Scene = step.environment.unwrapped.scene()  # type: ignore[attr-defined]
    height, width = step.image.shape[:2]
    return Frame(
        driver=driver.name,
        town=town,
        policy_version=driver.policy_version,
        episode_seed=step.seed,
        step=step.step,
        time=scene.time,
        ego=vars(scene.ego),
        vehicles=[vars(vehicle) for vehicle in scene.vehicles],
        route=[{"x": x, "y": y} for x, y in scene.route.tolist()],
        waypoint={"x": float(scene.waypoint[0]), "y": float(scene.waypoint[1])},
        target_speed=scene.target_speed,
        intention=step.intention,
        steering=scene.steering,
        acceleration=scene.acceleration,
        reward=step.reward,
        reward_terms=scene.reward_terms,
        episode_return=step.episode_return,
        image_height=height,
        image_width=width,
        birdeye=np.ascontiguousarray(step.image[:, :, :3]).tobytes(),
        lidar=np.ascontiguousarray(step.image[:, :, 3]).tobytes(),
    )
