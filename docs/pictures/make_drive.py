"""Draw the README's moving picture: `python docs/pictures/make_drive.py [POLICY.onnx]`.

The policy of the package drives through the roundabout of town03. On the left is the town, on the right
what the planner sees: drivable map, vehicles, route and lidar.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import gymnasium
import numpy as np
from athrl_driving.policy import OnnxPolicy, config_of
from athrl_driving.scenarios import SCENARIOS
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_spaces import CASE_STUDIES, CHANNELS
from numpy.typing import NDArray
from PIL import Image

PICTURE = Path(__file__).with_name("drive.webp")
SEED = 2
FIRST, LAST = 22, 95
"""The decisions that are shown: up to the ring, through it and out."""
HEIGHT, WIDTH = 400, 560
MILLISECONDS = 160
"""For which a decision of 0.4 s is shown."""

_SHADES = np.linspace((34, 55, 77), (255, 255, 255), 256).astype(np.uint8)
"""From 0 to 255: less black, so that what is faint is seen."""
_GAP = 8


def planner_view(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stack the channels of an observation, uint8 [size, size, 4], to a column of pictures."""
    side = (HEIGHT - (len(CHANNELS) - 1) * _GAP) // len(CHANNELS)
    column = np.full((HEIGHT, side, 3), 255, np.uint8)
    for channel in range(len(CHANNELS)):
        top = channel * (side + _GAP)
        tile = Image.fromarray(_SHADES[image[:, :, channel]]).resize((side, side), Image.Resampling.NEAREST)
        column[top : top + side] = np.asarray(tile)
    return column


def frames(policy: OnnxPolicy) -> Iterator[Image.Image]:
    """Drive and yield a picture of each decision that is shown."""
    view = {"screen_width": WIDTH, "screen_height": HEIGHT, "scaling": 7.0, "centering_position": [0.5, 0.5]}
    config = {**config_of(policy.description), **SCENARIOS[CASE_STUDIES["roundabout"]], "vehicles_count": 45}
    env = gymnasium.make("athrl/Town03-v0", render_mode="rgb_array", config={**config, **view})
    observation, _ = env.reset(seed=SEED)
    states, ended, decisions = policy.initial_states(1), False, 0
    while not ended and decisions < LAST:
        step = policy.step(observation["image"][None], observation["motion"][None], states)
        states = step.states
        action = policy.description.environment_action(step.actions)[0]
        observation, _, terminated, truncated, _ = env.step(action)
        ended, decisions = terminated or truncated, decisions + 1
        if decisions < FIRST:
            continue
        town = np.asarray(env.render())
        gap = np.full((HEIGHT, _GAP, 3), 255, np.uint8)
        yield Image.fromarray(np.hstack([town, gap, planner_view(observation["image"])]))
    env.close()


def main() -> None:
    """Write the picture."""
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else shipped_policy("town03")
    first, *others = frames(OnnxPolicy.load(file))
    first.save(
        PICTURE,
        save_all=True,
        append_images=others,
        duration=MILLISECONDS,
        loop=0,
        quality=60,
        method=4,
    )
    print(f"{PICTURE}: {1 + len(others)} pictures, {PICTURE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
