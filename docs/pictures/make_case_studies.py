"""Draw an episode of each case study as a strip: `python docs/pictures/make_case_studies.py [POLICY.onnx]`.

By default the policy of the package for town03 drives. Of each case study it is the first episode, from seed
700000 on, that succeeds.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import gymnasium
import numpy as np
from athrl_driving.policy import OnnxPolicy, config_of
from athrl_driving.scenarios import SCENARIOS
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_spaces import CASE_STUDIES
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

PICTURE = Path(__file__).with_name("case-studies.png")
FIRST_SEED = 700_000
MOST_EPISODES = 50
PANELS = 5
"""Of a strip, the same time apart, from the start to the destination."""
SIDE = 256
_TICK_SECONDS = 0.1
_GAP = 6
_TITLE = 26

Picture = NDArray[np.uint8]


def episode(policy: OnnxPolicy, scenario: str, seed: int) -> tuple[list[tuple[float, Picture]], bool]:
    """Return seconds and picture, uint8 [SIDE, SIDE, 3], of each decision; whether it succeeded."""
    view = {"screen_width": SIDE, "screen_height": SIDE, "scaling": 4.0, "centering_position": [0.5, 0.5]}
    config = {**config_of(policy.description), **SCENARIOS[scenario], **view}
    env = gymnasium.make("athrl/Town03-v0", render_mode="rgb_array", config=config)
    observation, info = env.reset(seed=seed)
    states, seconds = policy.initial_states(1), 0.0
    pictures = [(seconds, np.asarray(env.render()))]
    while True:
        step = policy.step(observation["image"][None], observation["motion"][None], states)
        states = step.states
        action = policy.description.environment_action(step.actions)[0]
        observation, _, terminated, truncated, info = env.step(action)
        seconds += info["ticks"] * _TICK_SECONDS
        pictures.append((seconds, np.asarray(env.render())))
        if terminated or truncated:
            env.close()
            return pictures, bool(info["metrics"]["success"])


def strip(policy: OnnxPolicy, name: str) -> Image.Image:
    """Return the strip of a case study with a line of text above it."""
    for seed in range(FIRST_SEED, FIRST_SEED + MOST_EPISODES):
        pictures, success = episode(policy, CASE_STUDIES[name], seed)
        if success:
            break
    else:
        raise SystemExit(f"{name}: none of {MOST_EPISODES} episodes from seed {FIRST_SEED} on succeeds")
    chosen = [pictures[place] for place in np.linspace(0, len(pictures) - 1, PANELS).round().astype(int)]
    drawn = Image.new("RGB", (PANELS * (SIDE + _GAP) - _GAP, SIDE + _TITLE), "white")
    pen, font = ImageDraw.Draw(drawn), ImageFont.load_default(size=15)
    pen.text((2, 4), f"{name}, seed {seed}: {pictures[-1][0]:.1f} s", "black", font)
    for number, (seconds, picture) in enumerate(chosen):
        left = number * (SIDE + _GAP)
        drawn.paste(Image.fromarray(picture), (left, _TITLE))
        pen.text((left + 6, _TITLE + 4), f"{seconds:.1f} s", "black", font)
    return drawn


def main() -> None:
    """Write the picture."""
    policy = OnnxPolicy.load(Path(sys.argv[1]) if len(sys.argv) > 1 else shipped_policy("town03"))
    strips = [strip(policy, name) for name in CASE_STUDIES]
    height = strips[0].height + _GAP
    drawn = Image.new("RGB", (strips[0].width, len(strips) * height - _GAP), "white")
    for number, each in enumerate(strips):
        drawn.paste(each, (0, number * height))
    drawn.save(PICTURE, optimize=True)
    print(f"{PICTURE.name}: {PICTURE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
