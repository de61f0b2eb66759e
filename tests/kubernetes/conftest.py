"""The overlays as Kustomize renders them; tests of containers run only when they are asked for."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.kubernetes.manifests import Overlay


@pytest.fixture(autouse=True, scope="session")
def _kubectl() -> None:
    if shutil.which("kubectl") is None:
        pytest.skip("no kubectl is installed here: apt-get install kubernetes-client")


@pytest.fixture(scope="module")
def overlay(request: pytest.FixtureRequest) -> Overlay:
    """The overlay that a test names, by `indirect` parameters."""
    return Overlay(request.param)
