"""Libraries of highway-env that driving in a town does not need are not loaded before they are used."""

import subprocess
import sys

HEAVY = ("pandas.core", "matplotlib.rcsetup", "scipy.linalg.blas")
TELL = f"print(*(name in sys.modules for name in {HEAVY}))"
DRIVES = (
    "import athrl_driving, gymnasium\n"
    "env = gymnasium.make('athrl/Town03-v0', config={'vehicles_count': 3})\n"
    "env.reset(seed=0)\n"
    "env.step(env.action_space.sample())\n"
)


def run(code: str) -> list[str]:
    result = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}"], capture_output=True, text=True, check=True, timeout=300
    )
    return result.stdout.split()


def test_driving_in_a_town_loads_no_tables_plots_or_linear_algebra() -> None:
    assert run(DRIVES + TELL) == ["False", "False", "False"]


def test_driving_a_batch_with_a_policys_runner_loads_no_tables_plots_or_linear_algebra() -> None:
    drives = (
        "from athrl_driving.policy import EnvironmentBatch\n"
        "EnvironmentBatch(['town03'] * 2, {'vehicles_count': 3}).close()\n"
    )
    assert run(drives + TELL) == ["False", "False", "False"]


def test_a_look_at_every_modules_file_loads_none() -> None:
    """Which `inspect` takes while torch is imported."""
    looks = (
        "import athrl_driving.maps\n"
        "deferred = [sys.modules[name] for name in ('pandas', 'matplotlib', 'matplotlib.pyplot')]\n"
        "print(all(hasattr(module, '__file__') for module in deferred))\n"
    )
    assert run(looks + TELL) == ["True", "False", "False", "False"]


def test_tables_are_loaded_when_used() -> None:
    looks = (
        "import athrl_driving.maps, gymnasium\n"
        "observation, _ = gymnasium.make('highway-v0').reset(seed=0)\n"  # made with a table
        "print(observation.shape)\n"
    )
    assert run(f"{TELL}\n{looks}{TELL}") == [
        *("False", "False", "False"),
        *("(5,", "5)"),
        *("True", "False", "False"),
    ]


def test_plots_are_loaded_when_used() -> None:
    plots = (
        "import athrl_driving.maps, matplotlib\n"
        "matplotlib.use('agg')\n"
        "from matplotlib import pyplot\n"
        "print(len(pyplot.plot([1, 2])), matplotlib.__version__ > '3', matplotlib.pyplot is pyplot)\n"
    )
    assert run(f"{plots}{TELL}") == ["1", "True", "True", "False", "True", "False"]


def test_modules_that_are_loaded_already_stay_as_they_are() -> None:
    assert run(f"import pandas, athrl_driving.maps\nprint(pandas.DataFrame([1]).size)\n{TELL}") == [
        "1",
        "True",
        "False",
        "False",
    ]


def test_driving_needs_no_tables_and_plots_installed() -> None:
    """Images leave them out. Others that ask for them are told so, and so is whoever uses them after all."""
    without = (
        "from importlib.machinery import PathFinder\n"
        "find = PathFinder.find_spec\n"
        "missing = lambda name: name.partition('.')[0] in ('pandas', 'matplotlib')\n"
        "PathFinder.find_spec = lambda name, *more: None if missing(name) else find(name, *more)\n"
    )
    asks = (
        "for use in ('import pandas', 'import matplotlib', 'gymnasium.make(\"highway-v0\").reset()'):\n"
        "    try: exec(use)\n"
        "    except ModuleNotFoundError as error: print(error.args[0].replace(' ', '-'))\n"
    )
    assert run(f"{without}{DRIVES}{asks}") == [
        "No-module-named-'pandas'",
        "No-module-named-'matplotlib'",
        "pandas.DataFrame-is-used-and-pandas-is-not-installed",
    ]


def test_linear_algebra_is_loaded_when_used() -> None:
    uses = (
        "import athrl_driving, gymnasium, numba, numpy\n"
        "gymnasium.make('athrl/Town03-v0', config={'vehicles_count': 3}).reset(seed=0)\n"
        "invert = numba.njit(lambda matrix: numpy.linalg.inv(numpy.dot(matrix, matrix)))\n"
        "print(invert(numpy.eye(2)).sum())\n"
        "import scipy\n"
        "print(scipy.linalg.norm([3.0, 4.0]))\n"
    )
    assert run(uses + TELL) == ["2.0", "5.0", "False", "False", "True"]
