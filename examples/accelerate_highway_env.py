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
    started = time.perf_counter()
    for _ in range(STEPS):
        observation, _, terminated, truncated, _ = env.step(1)
        if terminated or truncated:
            break
    return STEPS / (time.perf_counter() - started), observation


plain_rate, plain = drive(gymnasium.make("highway-v0", config=CONFIG))
fast_rate, fast = drive(accelerate(gymnasium.make("highway-v0", config=CONFIG)))
print(
    f"highway-env {plain_rate:.1f} steps/s, accelerated {fast_rate:.1f}: {fast_rate / plain_rate:.0f} times"
)
print("the same observation:", np.allclose(plain, fast, atol=1e-9))
