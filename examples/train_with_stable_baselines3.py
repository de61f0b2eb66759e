"""Train Stable-Baselines3's PPO: `python examples/train_with_stable_baselines3.py [DECISIONS]`.

Its network for images takes no less than 36 pixels, so the environments draw 64. A useful policy takes a
million decisions; the default here only shows that it runs.
"""

import sys

import athrl_driving  # noqa: F401  (registers the environments)
import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

decisions = int(sys.argv[1]) if len(sys.argv) > 1 else 256
config = {"image_size": 64, "vehicles_count": 50, "episode_ticks": 100}

envs = make_vec_env(lambda: gymnasium.make("athrl/Town03-v0", config=config), n_envs=2)
model = PPO("MultiInputPolicy", envs, n_steps=64, batch_size=64, verbose=1)
model.learn(decisions)

env = gymnasium.make("athrl/Town03-v0", config=config)
observation, _ = env.reset(seed=1)
total, ended = 0.0, False
while not ended:
    action, _ = model.predict(observation, deterministic=True)
    observation, reward, terminated, truncated, _ = env.step(action)
    total += float(reward)
    ended = terminated or truncated
print(f"return of one episode: {total:.0f}")
