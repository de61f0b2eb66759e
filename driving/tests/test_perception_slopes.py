"""The route is seen on a slope, and not where another road passes high above or far below."""

from pathlib import Path

import numpy as np
from athrl_driving.envs import TownEnv

from driving.tests.written_maps import HALF_LANE, element, lane, road

SLOPE = 0.05


def steep(folder: Path) -> Path:
    """A straight road of 300 m that climbs evenly by 15 m."""
    lanes = element("right", lane(-1))
    text = road(1, "<line/>", (0.0, 0.0, 0.0), 300.0, lanes, offset=HALF_LANE)
    level, climbing = 'a="0.0" b="0"', f'a="0.0" b="{SLOPE}"'
    assert level in text
    path = folder / "steep.xodr"
    path.write_text(element("OpenDRIVE", text.replace(level, climbing)))
    return path


def test_route_is_seen_all_the_way_up(tmp_path: Path) -> None:
    map_file = str(steep(tmp_path))
    shown = []
    for s in (20.0, 100.0, 180.0):
        env = TownEnv(config={"town": map_file, "start": ("road 1", -1, s), "vehicles_count": 0})
        observation, _ = env.reset(seed=1)
        shown.append(observation["image"][:, :, 2])
    assert shown[0].max() > 100
    for image in shown[1:]:
        np.testing.assert_array_equal(image, shown[0])
