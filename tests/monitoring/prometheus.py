"""A real Prometheus that scrapes a test's endpoints, asked by its HTTP API."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tests.monitoring.files import ALERTS, CONFIGURATION

ANSWER_SECONDS = 30.0
START_SECONDS = 60.0


@dataclass(frozen=True)
class Prometheus:
    """Where a running Prometheus answers."""

    port: int

    def ask(self, path: str, **parameters: str) -> Any:
        """Return the data of an answer; a query that is wrong is an HTTPError."""
        url = f"http://127.0.0.1:{self.port}/api/v1/{path}?{urllib.parse.urlencode(parameters)}"
        with urllib.request.urlopen(url, timeout=ANSWER_SECONDS) as answer:
            return json.load(answer)["data"]

    def ready(self) -> bool:
        """Whether it answers."""
        try:
            return bool(self.ask("status/runtimeinfo"))
        except OSError:
            return False

    def values(self, query: str) -> list[float]:
        """The values of a query now, one for each series."""
        return [float(series["value"][1]) for series in self.ask("query", query=query)["result"]]

    def targets(self) -> dict[str, str]:
        """The health of what is scraped, by job: up, down or unknown."""
        active = self.ask("targets")["activeTargets"]
        return {target["labels"]["job"]: target["health"] for target in active}


@contextmanager
def running_prometheus(folder: Path, port: int, targets: Mapping[str, int]) -> Iterator[Prometheus]:
    """Run Prometheus with the project's configuration, with ports of this machine as each job's target.

    It answers when this returns.
    """
    configuration = yaml.safe_load(CONFIGURATION.read_text())
    configuration["global"] = {"scrape_interval": "1s", "evaluation_interval": "1s"}
    for job in configuration["scrape_configs"]:
        job.pop("dns_sd_configs", None)
        job["static_configs"] = [{"targets": [f"127.0.0.1:{targets[job['job_name']]}"]}]
    (folder / "prometheus.yml").write_text(yaml.safe_dump(configuration))
    shutil.copy(ALERTS, folder)
    arguments = [
        f"--config.file={folder / 'prometheus.yml'}",
        f"--storage.tsdb.path={folder / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    with (folder / "prometheus.log").open("w") as log:
        process = subprocess.Popen(["prometheus", *arguments], stdout=log, stderr=log)
    prometheus, deadline = Prometheus(port), time.monotonic() + START_SECONDS
    try:
        while not prometheus.ready():
            assert process.poll() is None, (folder / "prometheus.log").read_text()
            assert time.monotonic() < deadline, f"Prometheus does not answer after {START_SECONDS:.0f} s"
            time.sleep(0.1)
        yield prometheus
    finally:
        process.terminate()
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(timeout=10)
