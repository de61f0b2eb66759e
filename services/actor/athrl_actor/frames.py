"""A moment of an actor's first environment as the message that is shown live."""

from __future__ import annotations

import numpy as np
from athrl_driving import Scene
from athrl_protocol import Frame

from athrl_actor.rollout import Moment


def frame_of(town: str, moment: Moment) -> Frame:
    """Describe a moment."""
    scene: Scene = moment.environment.unwrapped.scene()  # type: ignore[attr-defined]
    height, width = moment.image.shape[:2]
    return Frame(
        driver="policy",
        town=town,
        policy_version=moment.policy_version,
        episode_seed=moment.episode_seed,
        step=moment.step,
        time=scene.time,
        ego=vars(scene.ego),
        vehicles=[vars(vehicle) for vehicle in scene.vehicles],
        route=[{"x": x, "y": y} for x, y in scene.route.tolist()],
        waypoint={"x": float(scene.waypoint[0]), "y": float(scene.waypoint[1])},
        target_speed=scene.target_speed,
        intention=moment.intention,
        steering=scene.steering,
        acceleration=scene.acceleration,
        reward=moment.reward,
        reward_terms=scene.reward_terms,
        episode_return=moment.episode_return,
        image_height=height,
        image_width=width,
        birdeye=np.ascontiguousarray(moment.image[:, :, :3]).tobytes(),
        lidar=np.ascontiguousarray(moment.image[:, :, 3]).tobytes(),
    )
