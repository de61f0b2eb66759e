"""Score the policy of the package: `python examples/evaluate_a_policy.py [FOLDER]`.

The episodes go into FOLDER as MCAP files: `athrl watch FOLDER/...mcap` shows one in rerun.
"""

import sys
from pathlib import Path

from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_protocol.run_file import EnvironmentSection

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("recordings")
settings = EvaluationSettings(episodes=4, seed=1, environment=EnvironmentSection(vehicles=100))
drivers = {"town03": shipped_policy("town03"), "rule-based": "rule-based"}

for name, driver in drivers.items():
    scores = evaluate_driver(driver, settings, record=folder)
    print(
        f"{name:12}return {scores.return_mean:.0f} ± {scores.return_ci95:.0f},"
        f" collisions {scores.collision_rate:.0%}, full episodes {scores.full_episode_rate:.0%}"
    )
print("recordings:", *sorted(path.name for path in folder.glob("*.mcap")))
