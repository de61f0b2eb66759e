"""How long a checkpoint stops training, beside a copy of the replay, and how long resuming from it takes.

The learner of the default run file, with a full replay. Training waits for the "snapshot"; writing happens in
parallel. "Copy" is the time that a checkpoint with a copy of the replay would need instead.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import torch
from athrl.ports import free_address
from athrl.runs import declare_installed_planners
from athrl_learner import factories
from athrl_learner.checkpoint import CheckpointContent, read_checkpoint, write_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.run import frozen_garbage_collector
from athrl_planners import Agent
from athrl_protocol import ChunkIntake, RunFile, encode_chunk, open_session, read_run_file

from benchmarks.experience import numbered, synthetic_chunk

#: Different chunks; the replay holds each of them many times.
_DIFFERENT = 50


def filled(run_file: RunFile, folder: Path, agent: Agent) -> ExperienceStore:
    """A store whose replay is full."""
    store = make_experience(run_file, agent, Arrivals(), factories.make_log(run_file, folder))
    steps = run_file.replay.sequence_length
    chunks = [synthetic_chunk(steps, seed=seed) for seed in range(_DIFFERENT)]
    for sequence in range(store.replay.slots):
        chunk = numbered(chunks[sequence % _DIFFERENT], sequence)
        store.accept(chunk, encode_chunk(chunk))
    return store


def milliseconds_of_snapshots(
    run_file: RunFile, agent: Agent, store: ExperienceStore, repeats: int
) -> tuple[list[tuple[float, float]], CheckpointContent]:
    """What each of `repeats` snapshots between two updates took, of the clock and of a core; the last one."""
    taken = []
    with (
        open_session(listen=free_address(), timeout=10) as session,
        ChunkIntake(session, "benchmark", store) as intake,
    ):
        for _ in range(repeats):
            agent.update(store.replay.sample(run_file.learner.batch))
            began, busy = time.perf_counter(), time.thread_time()
            content = take_snapshot(run_file, agent, store, intake, policy_version=1)
            taken.append((1000 * (time.perf_counter() - began), 1000 * (time.thread_time() - busy)))
    return taken, content


def milliseconds_of_copies(store: ExperienceStore, repeats: int) -> list[float]:
    """What it takes to copy the replay's columns."""
    taken = []
    for _ in range(repeats):
        began = time.perf_counter()
        copies = [column.copy() for column in store.replay.columns().values()]
        taken.append(1000 * (time.perf_counter() - began))
        del copies
    return taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, default=100_000, help="in the replay")
    parser.add_argument("--repeats", type=int, default=20, help="snapshots")
    arguments = parser.parse_args()
    declare_installed_planners()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_file = read_run_file(
            None,
            [
                f"replay.capacity={arguments.transitions}",
                "learner.samples_per_insert=0.001",
                f"run.environment_steps={10 * arguments.transitions}",
            ],
        )
        torch.set_num_threads(run_file.learner.threads or 1)
        agent = factories.make_agent(run_file)
        store = filled(run_file, folder / "experience", agent)
        with frozen_garbage_collector():
            snapshots, content = milliseconds_of_snapshots(run_file, agent, store, arguments.repeats)
        copies = milliseconds_of_copies(store, 3)
        began = time.perf_counter()
        store.log.sync()
        path = write_checkpoint(folder / "checkpoints", content)
        written = time.perf_counter() - began
        other = factories.make_agent(run_file)
        restored = make_experience(
            run_file, other, Arrivals(), factories.make_log(run_file, folder / "experience")
        )
        began = time.perf_counter()
        restore_snapshot(read_checkpoint(path), other, restored)
        resumed = time.perf_counter() - began
        clock, core = (sorted(values) for values in zip(*snapshots, strict=True))
        result = {
            "transitions": len(store.replay),
            "snapshot_ms_median": statistics.median(clock),
            "snapshot_ms_worst": clock[-1],
            "snapshot_cpu_ms_median": statistics.median(core),
            "snapshot_cpu_ms_worst": core[-1],
            "copy_ms_median": statistics.median(copies),
            "ratio": statistics.median(copies) / statistics.median(clock),
            "write_s": written,
            "checkpoint_bytes": sum(file.stat().st_size for file in path.iterdir()),
            "log_bytes": store.log.size_bytes,
            "resume_s": resumed,
        }
        store.log.close()
        restored.log.close()
    print(
        f"{result['transitions']} transitions: training waits {result['snapshot_ms_median']:.1f} ms for a "
        f"snapshot ({result['snapshot_ms_worst']:.1f} ms at worst, of which a core works "
        f"{result['snapshot_cpu_ms_worst']:.1f} ms); a copy of the replay takes "
        f"{result['ratio']:.0f} times as long; resumed in {resumed:.1f} s"
    )
    print(json.dumps({name: round(value, 3) for name, value in result.items()}))


if __name__ == "__main__":
    main()
