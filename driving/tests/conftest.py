"""Fixtures for all tests of the package."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from athrl_driving.maps import Town, load_town
from athrl_spaces import is_town

sys.path.insert(0, str(Path(__file__).parents[2]))  # driving.tests is no installed package

_CARLA = Path(os.environ.get("ATHRL_TOWNS", Path(__file__).resolve().parents[3] / "shared" / "towns"))


@pytest.fixture(scope="session")
def load_any() -> Callable[[str], Town]:
    """Load a town of the project by name, or one of CARLA's by file name; skip if the file is absent."""

    def load(name: str) -> Town:
        if is_town(name):
            return load_town(name)
        if not (_CARLA / name).exists():
            pytest.skip(f"CARLA's {name} is not in {_CARLA}; set ATHRL_TOWNS to the folder that has it")
        return load_town(_CARLA / name)

    return load
