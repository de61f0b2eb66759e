"""The kernels are compiled when an environment is accelerated, and kept apart from those of the towns."""

import subprocess
import sys
from pathlib import Path

import athrl_accelerate
import pytest
from athrl_driving.kernels import compilation

_FIRST_STEPS = """
import gc
import gymnasium, highway_env
from numba.core.dispatcher import Dispatcher
from athrl_accelerate import accelerate

def known():
    return {
        (kernel.py_func.__module__, kernel.py_func.__qualname__, signature)
        for kernel in gc.get_objects()
        if isinstance(kernel, Dispatcher)
        for signature in kernel.overloads
        if kernel.py_func.__module__.startswith("athrl_")
    }

envs = [gymnasium.make(name) for name in ("highway-v0", "intersection-v1", "racetrack-v0", "roundabout-v0")]
accelerate(envs[0])
before = known()
for env in envs:
    accelerate(env).reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    road = env.unwrapped.road
    road.neighbour_vehicles(env.unwrapped.vehicle)
    road.network.get_closest_lane_index(env.unwrapped.vehicle.position, 0.0)
assert before
print(sorted(known() - before))
"""


def test_nothing_is_compiled_after_an_environment_is_accelerated() -> None:
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _FIRST_STEPS],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_changed_constants_of_towns_leave_the_kernels_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = compilation.fingerprint(athrl_accelerate.__name__)
    changed = tmp_path / "action_kinds.py"
    changed.write_bytes(b"MAXIMUM_STEERING = 0.4")
    monkeypatch.setattr(compilation, "_CONSTANTS", [changed])
    assert compilation.fingerprint(athrl_accelerate.__name__) == before
