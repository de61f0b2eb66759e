"""Scenes with vehicles near standstill, run freely: the effect of the last bit of NumPy's functions.

On a processor with AVX-512 NumPy computes tan, arcsin, arctan and power by routines of its own, which round
some results to the next number. Near standstill highway-env's steering magnifies that a million times within
a few frames, so highway-env itself runs differently there than on another processor. The kernels take the C
library's functions, as NumPy does without AVX-512.
"""

import json
import os
import subprocess
import sys

import pytest

AVX512 = (
    "X86_V4 AVX512F AVX512CD AVX512VL AVX512BW AVX512DQ AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"
    " AVX512_SPR AVX512VNNI AVX512IFMA AVX512VBMI AVX512VBMI2 AVX512BITALG AVX512VPOPCNTDQ AVX512FP16"
)

RUN_FREELY = """
import json, sys
import gymnasium, highway_env
from athrl_accelerate.parity import difference
from athrl_accelerate.road import accelerate_road

greatest, slowest = 0.0, 100.0
pair = [gymnasium.make(sys.argv[1]).unwrapped for _ in range(2)]
for peer in pair:
    peer.reset(seed=int(sys.argv[2]))
    peer.action_space.seed(int(sys.argv[2]))
accelerate_road(pair[1].road)
for frame in range(100):
    for peer in pair:
        if frame % 8 == 0:
            peer.action_type.act(peer.action_space.sample())
        peer.road.act()
        peer.road.step(1 / peer.config["simulation_frequency"])
    greatest = max(greatest, difference(pair[0].road, pair[1].road))
    slowest = min([slowest, *(abs(vehicle.speed) for vehicle in pair[0].road.vehicles)])
print(json.dumps([greatest, slowest]))
"""


@pytest.mark.parametrize(
    ("environment", "seed"),
    [("roundabout-v0", 3), ("roundabout-v1", 2), ("roundabout-v1", 3), ("intersection-v2", 0)],
)
def test_highway_free_roads_stay_together_near_standstill_with_the_c_librarys_functions(
    environment: str, seed: int
) -> None:
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RUN_FREELY, environment, str(seed)],
        env={**os.environ, "NPY_DISABLE_CPU_FEATURES": AVX512},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    greatest, slowest = json.loads(found.stdout.splitlines()[-1])
    assert greatest < 1e-9
    assert slowest < 0.05, "no vehicle is near standstill, so the test proves nothing"
