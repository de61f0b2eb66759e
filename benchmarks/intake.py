"""How many transitions a second one learner receives, logs and acknowledges from 1, 4 and 16 actors.

Real sessions over loopback and real uploaders. Each actor is a separate process that only sends 64-step
chunks of 32 x 32 x 4 pixels; the learner's side is its intake, log and replay, without training. The
actors share the machine with it. `benchmarks.reverb_intake` measures dm-reverb beside it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path

from athrl.ports import free_address
from athrl.runs import declare_installed_planners
from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_protocol import ChunkIntake, RunFile, open_session, read_run_file, serve_run_file

from benchmarks.light_actor import RUN, STEPS
from benchmarks.light_actors import light_actors, wait_until_filled
from benchmarks.router import KINDS, standing_before

_PATIENCE = 60.0


def rate(run_file: RunFile, actors: int, seconds: float, folder: Path, through: str) -> dict[str, float]:
    """Transitions a second that are taken in, and what they cost the learner and the actors."""
    store = make_experience(
        run_file, factories.make_agent(run_file), Arrivals(), factories.make_log(run_file, folder)
    )
    listen = free_address()
    with (
        contextlib.closing(store.log),
        open_session(listen=listen, timeout=_PATIENCE) as session,
        serve_run_file(session, run_file),
        ChunkIntake(session, RUN, store) as intake,
        standing_before(listen, through, RUN) as address,
    ):
        with light_actors([address] * actors) as reports:
            wait_until_filled(store)
            before, began, busy = store.environment_steps, time.perf_counter(), time.process_time()
            written = store.log.size_bytes
            time.sleep(seconds)
            taken, elapsed = store.environment_steps - before, time.perf_counter() - began
            busy, written = time.process_time() - busy, store.log.size_bytes - written
        stored, steps = intake.statistics().stored, store.environment_steps
    acknowledged = sum(report["acknowledged"] for report in reports)
    if not acknowledged == stored == steps / STEPS:
        sys.exit(f"{acknowledged} chunks acknowledged, {stored} stored, {steps} steps: something was lost")
    actors_busy = sum(report["busy"] for report in reports)
    return {
        "actors": actors,
        "transitions_per_second": taken / elapsed,
        "learner_cores": busy / elapsed,
        "learner_microseconds": 1e6 * busy / taken,  # of a core, for one transition
        "actors_microseconds": 1e6 * actors_busy / steps,
        "log_mebibytes_per_second": written / 2**20 / elapsed,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actors", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--seconds", type=float, default=10.0, help="for each number of actors")
    parser.add_argument("--fsync", choices=["never", "acknowledgement", "interval"], default="interval")
    parser.add_argument("--through", choices=KINDS, default="nothing", help="stands before the learner")
    parser.add_argument("--folder", type=Path, help="where the log is written; by default a temporary one")
    arguments = parser.parse_args()
    declare_installed_planners()
    run_file = read_run_file(
        None,
        [
            f"run.name={RUN}",
            f"replay.sequence_length={STEPS}",
            "learner.samples_per_insert=0.001",
            "run.environment_steps=1000000000",
            "replay.capacity=25600",
            f"durability.fsync={arguments.fsync}",
        ],
    )
    rows = []
    for actors in arguments.actors:
        with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
            row = rate(run_file, actors, arguments.seconds, Path(folder) / "experience", arguments.through)
        rows.append({name: round(value, 2) for name, value in row.items()})
        print(
            f"{actors:3d} actors: {row['transitions_per_second']:9,.0f} transitions/s, "
            f"the learner takes {row['learner_cores']:.2f} cores; a transition costs it "
            f"{row['learner_microseconds']:.1f} us of a core, an actor {row['actors_microseconds']:.1f} us"
        )
    facts = {"cores": os.cpu_count(), "load": os.getloadavg()[0], "fsync": arguments.fsync}
    print(json.dumps({**facts, "through": arguments.through, "rows": rows}))


if __name__ == "__main__":
    main()
