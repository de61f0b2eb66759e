"""A running cluster as tests see it: Slurm's commands, and the processes of its jobs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.slurm.daemons import START_SECONDS, STOP_SECONDS, configuration, processes_of_jobs

ROOT = Path(__file__).parents[2]
NICENESS = "5"
"""Of the jobs and the daemons, so that the tests' own commands answer while jobs want all cores."""


@dataclass(frozen=True)
class Cluster:
    """A cluster whose files are in `folder`; all nodes but the island share `folder`/shared/runs."""

    folder: Path

    @property
    def shared(self) -> Path:
        """Folder from which runs are submitted."""
        return self.folder / "shared"

    @property
    def environment(self) -> dict[str, str]:
        """Variables for Slurm's commands."""
        return {**os.environ, "SLURM_CONF": str(configuration(self.folder))}

    def run(self, *words: str) -> str:
        """Run a command of Slurm and return what it printed; it must succeed."""
        done = subprocess.run(
            words, env=self.environment, capture_output=True, text=True, timeout=30, check=False
        )
        assert done.returncode == 0, f"{words}: {done.stderr}"
        return done.stdout

    def processes_of_jobs(self) -> list[psutil.Process]:
        """Return all processes of jobs."""
        return processes_of_jobs(configuration(self.folder))


@contextmanager
def started_cluster(folder: Path) -> Iterator[Cluster]:
    """Start a cluster in a new folder; it ends with the block, or with this process, however that ends."""
    words = ["nice", "-n", NICENESS, sys.executable, "-m", "tests.slurm.daemons", str(folder)]
    with subprocess.Popen(
        words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            assert "SLURM_CONF" in process.stdout.readline(), f"no cluster within {START_SECONDS:g} s"
            yield Cluster(folder)
        finally:
            process.stdin.close()
            process.wait(8 * STOP_SECONDS)


def installed() -> bool:
    """Return whether Slurm's daemons and commands are on this machine."""
    return all(shutil.which(name) for name in ("slurmctld", "slurmd", "sbatch", "squeue", "scancel"))
