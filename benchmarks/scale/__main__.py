"""How far a run scales: sixteen real actors in racks, intake and routers at full load, and what follows.

    python -m benchmarks.scale                  print the measurements, and what follows, as one JSON object
    python -m benchmarks.scale --write          also write benchmarks/results/scale.json and scale-plan.json

Racks are network namespaces; packets to and from each take 10 ms and 0.1 % of them are lost. It needs root.
Costs are seconds of a core, which a busy machine changes little; rates are what two shared cores gave.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from athrl.runs import declare_installed_planners
from athrl_protocol import RunFile, read_run_file

from benchmarks.light_crowd import RUN
from benchmarks.result_tables import RESULTS
from benchmarks.scale.connections import connect
from benchmarks.scale.driving import drive
from benchmarks.scale.flood import WAYS, flood
from benchmarks.scale.plan import bounds, need
from benchmarks.scale.racks import racks, why_not
from benchmarks.scale.results import measured_table, plan_table

_ROOT = Path(__file__).parents[2]


def run_file_of_intake() -> RunFile:
    """Settings of a learner that only takes in, with the default chunks and a replay that soon is full."""
    return read_run_file(
        None,
        [
            f"run.name={RUN}",
            "learner.samples_per_insert=0.001",
            "run.environment_steps=1000000000",
            "replay.capacity=12800",
        ],
    )


def measure(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Return all measurements, by what was measured."""
    declare_installed_planners()
    run_file = run_file_of_intake()
    with racks(arguments.racks, arguments.delay / 1000, arguments.loss) as (made, line):
        flooded = []
        for number, way in enumerate(WAYS):
            flooded.append(
                flood(way, run_file, made, arguments.actors, arguments.seconds, folder / f"flood-{number}")
            )
            print(f"{way}: {flooded[-1]}", file=sys.stderr, flush=True)
        driven = drive(made, arguments.actors, arguments.seconds, folder / "driving")
        print(driven, file=sys.stderr, flush=True)
    connected = connect(run_file, arguments.connections, folder / "connections")
    print(connected, file=sys.stderr, flush=True)
    return {"flooded": flooded, "driven": driven, "connected": connected, "line": line}


def main() -> None:
    """Measure, print and, if that is wanted, write the tables' files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--actors", type=int, default=16)
    parser.add_argument("--racks", type=int, default=4)
    parser.add_argument("--delay", type=float, default=10.0, help="milliseconds, each way")
    parser.add_argument("--loss", type=float, default=0.001, help="share of packets")
    parser.add_argument("--seconds", type=float, default=20.0, help="for each measurement")
    parser.add_argument("--connections", type=int, default=200, help="actors that connect, for their memory")
    parser.add_argument("--per-actor", type=float, default=500.0, help="decisions a second, for the plan")
    parser.add_argument("--write", action="store_true", help="write the files of the tables")
    arguments = parser.parse_args()
    if not 1 <= arguments.racks <= arguments.actors or arguments.connections % 2:
        parser.error(
            f"--racks {arguments.racks} should be 1 to --actors {arguments.actors}, and --connections "
            f"{arguments.connections} an even number"
        )
    # Ended by a signal, it removes its networks and ends its processes as well.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    if reason := why_not():
        sys.exit(f"python -m benchmarks.scale: {reason}")
    with tempfile.TemporaryDirectory() as folder:
        found = measure(arguments, Path(folder))
    flooded, driven, connected = found["flooded"], found["driven"], found["connected"]
    needs = {
        actors: need(actors, arguments.per_actor, flooded, driven, connected)
        for actors in (arguments.actors, 1000, 10_000)
    }
    about = {
        "command": shlex.join(["python", "-m", "benchmarks.scale", *sys.argv[1:]]),
        "commit": _commit(),
        "date": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}",
    }
    load = os.getloadavg()[0]
    if arguments.write:
        tables = (
            measured_table(flooded, driven, arguments.delay, arguments.loss, load) | about,
            plan_table(bounds(flooded, driven, connected), needs, arguments.per_actor) | about,
        )
        for table in tables:
            path = _ROOT / RESULTS / f"{table['subject']}.json"
            path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
            print(f"wrote {path.relative_to(_ROOT)}", file=sys.stderr)
    facts = {
        "flooded": [asdict(each) for each in flooded],
        "driven": asdict(driven),
        "connected": asdict(connected),
        "line": asdict(found["line"]),
        "needs": {actors: asdict(each) for actors, each in needs.items()},
    }
    print(json.dumps({"cores": os.cpu_count(), "load": round(load, 1), **facts}))


def _commit() -> str:
    words = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(words, cwd=_ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    main()
