"""Drive a few decisions, so that the compiled kernels are in the cache before the first start."""

import athrl_driving  # noqa: F401  (registers the environment)
import gymnasium

environment = gymnasium.make("athrl/Town03-v0")
environment.reset(seed=0)
for _ in range(3):
    environment.step(environment.action_space.sample())
environment.close()
