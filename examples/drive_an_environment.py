"""Drive one episode in a town of 100 vehicles: `python examples/drive_an_environment.py`."""

import athrl_driving
import gymnasium

env = gymnasium.make("athrl/Town03-v0", config={"vehicles_count": 100})
driver = athrl_driving.make_driver("rule-based")

observation, info = env.reset(seed=1)
print("what the planner sees:", {name: (array.dtype, array.shape) for name, array in observation.items()})
print("what it decides:", env.action_space)

driver.reset(env, 1)
total, ended = 0.0, False
while not ended:
    observation, reward, terminated, truncated, info = env.step(driver.act(env))
    total += float(reward)
    ended = terminated or truncated

metrics = info["metrics"]
print(f"return {total:.0f}, {info['distance']:.0f} m, collision {info['collision']}")
print("driving score:", round(metrics["driving_score"], 3))
env.close()
