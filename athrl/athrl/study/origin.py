"""With what and where figures were made."""

from __future__ import annotations

import platform
import subprocess
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from athrl.train.plan import usable_cores


def origin() -> dict[str, Any]:
    """Return version, commit (empty where it is not known), date, cores of this thread, and processor."""
    return {
        "version": version("athrl"),
        "commit": _commit(),
        "date": time.strftime("%Y-%m-%d"),
        "cores": usable_cores(),
        "processor": _processor(),
    }


@cache
def _commit() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
        return done.stdout.strip()
    except (OSError, subprocess.TimeoutExpired):  # no git
        return ""


@cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
