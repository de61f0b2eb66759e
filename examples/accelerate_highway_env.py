"""How much faster highway-env gets: `python examples/accelerate_highway_env.py`."""

import time

import gymnasium
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
from athrl_accelerate import accelerate

CONFIG = {"vehicles_count": 50, "duration": 100}
STEPS = 20


def drive(env: gymnasium.Env) -> tuple[float, np.ndarray]:
    """Return steps a second and the last observation."""
    env.reset(seed=0)
    env.step(1)  # compiles, where nothing is compiled yet
    started, steps, ended = time.perf_counter(), 0, False
    while steps < STEPS and not ended:
        observation, _, terminated, truncated, _ = env.step(1)
        steps, ended = steps + 1, terminated or truncated
    return steps / (time.perf_counter() - started), observation


plain_rate, plain = drive(gymnasium.make("highway-v0", config=CONFIG))
fast_rate, fast = drive(accelerate(gymnasium.make("highway-v0", config=CONFIG)))
print(
    f"highway-env {plain_rate:.1f} steps/s, accelerated {fast_rate:.1f}: {fast_rate / plain_rate:.0f} times"
)
print("the same observation:", np.allclose(plain, fast, atol=1e-9))
