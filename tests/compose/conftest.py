"""The tests that build on containers run only when they are asked for."""

import pytest


@pytest.fixture(autouse=True)
def _asked_for(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("--compose"):
        pytest.skip("containers only with --compose")
