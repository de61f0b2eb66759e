"""A real Slurm for the tests of this folder; it is started only when it is asked for."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.slurm.cluster import Cluster, installed, started_cluster


@pytest.fixture(autouse=True, scope="session")
def _asked_for(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("--slurm"):
        pytest.skip("a real Slurm only with --slurm")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Slurm's daemons on this machine."""
    if not installed():
        pytest.fail("--slurm needs Slurm's daemons: apt-get install slurmctld slurmd slurm-client")
    with started_cluster(tmp_path_factory.mktemp("slurm") / "cluster") as cluster:
        yield cluster
    assert not cluster.processes_of_jobs()
