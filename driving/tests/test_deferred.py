"""What nobody who drives in a town uses of highway-env's libraries is not loaded before somebody uses it."""

import subprocess
import sys

HEAVY = ("pandas.core", "matplotlib.figure")
TELL = f"print(*(name in sys.modules for name in {HEAVY}))"


def run(code: str) -> list[str]:
    result = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}"], capture_output=True, text=True, check=True, timeout=300
    )
    return result.stdout.split()


def test_driving_in_a_town_loads_neither_tables_nor_plots() -> None:
    drives = (
        "import athrl_driving, gymnasium\n"
        "env = gymnasium.make('athrl/Town03-v0', config={'vehicles_count': 3})\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n"
    )
    assert run(drives + TELL) == ["False", "False"]


def test_driving_a_batch_with_a_policys_runner_loads_neither_tables_nor_plots() -> None:
    drives = (
        "from athrl_driving.policy import EnvironmentBatch\n"
        "EnvironmentBatch('town03', {'vehicles_count': 3}, 2).close()\n"
    )
    assert run(drives + TELL) == ["False", "False"]


def test_who_uses_tables_has_them() -> None:
    looks = (
        "import athrl_driving.maps, gymnasium\n"
        "observation, _ = gymnasium.make('highway-v0').reset(seed=0)\n"  # made by way of a table
        "print(observation.shape)\n"
    )
    assert run(f"{TELL}\n{looks}{TELL}") == ["False", "False", "(5,", "5)", "True", "False"]


def test_what_somebody_has_loaded_stays_as_it_is() -> None:
    assert run(f"import pandas, athrl_driving.maps\nprint(pandas.DataFrame([1]).size)\n{TELL}") == [
        "1",
        "True",
        "False",
    ]
