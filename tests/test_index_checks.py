"""No kernel uses an index that is wrong, wherever one drives; `index_checks` is the build that tells."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_no_index_is_wrong_on_any_map_with_any_settings() -> None:
    environment = {**os.environ, "ATHRL_CHECK_INDICES": "1", "PYTHONFAULTHANDLER": "1"}
    result = subprocess.run(
        [sys.executable, "-m", "tests.random_driving", "1"],
        cwd=ROOT, capture_output=True, text=True, timeout=1700, env=environment,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-4000:]
    *drives, broken = result.stdout.splitlines()
    assert len(drives) > 30
    assert broken.endswith("places, it is indexed with -1")  # and the checks were there
