"""How many decisions a second training takes in: our update, the same one in plain torch, and a PPO's.

    python -m benchmarks.updates                     # one thread, this machine's faster precision
    python -m benchmarks.updates --precision float32 # in which the losses of ours and the plain one are equal
    python -m benchmarks.updates --sampling          # only what the replay takes to draw a batch
    python -m benchmarks.updates --device cuda       # ours and the plain one on a GPU as well

Ours trains the planner atHRL on images of 32 x 32 out of its replay: 512 single decisions, and 16, 64 and 128
sequences of 10 with an LSTM. "Plain" is `benchmarks.plain_update`, the same mathematics in straightforward
eager float32. The PPO is Stable-Baselines3's, its own `train()` on a full rollout buffer of such observations
in batches of 512, with the networks that it has in `benchmarks.peers`. All take turns in one process. Counted
are decisions in batches, each time they are drawn; sampling is included. `..._a_core` is by the processor's
time instead of the clock's, which others on the machine do not change. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from athrl_planners import Agent, Sequence, SequenceReplay, make_agent
from athrl_planners.factories import make_replay
from athrl_planners.training.precision import faster_precision
from athrl_spaces import Observation

from benchmarks.experience import synthetic_chunk
from benchmarks.plain_update import PlainUpdate

DECISIONS = 20_000  # in the replay
LENGTH = 10  # of a sequence
WARM_UP = 5  # updates
DIFFERENT = 50  # sequences; the replay holds each of them many times
SHAPES = ("512", "16x10", "64x10", "128x10")


@dataclass
class Contestant:
    """Something that trains: `update` trains once and returns on how many decisions."""

    name: str
    update: Callable[[], int]
    device: str = "cpu"
    rates: list[float] = field(default_factory=list)
    rates_a_core: list[float] = field(default_factory=list)

    def warm_up(self) -> None:
        """Let it allocate what it will need."""
        for _ in range(WARM_UP):
            self.update()

    def turn(self, seconds: float) -> None:
        """Train for so long, and note the decisions a second."""
        began, worked, decisions = time.perf_counter(), time.process_time(), 0
        while time.perf_counter() - began < seconds:
            decisions += self.update()
        if self.device == "cuda":
            torch.cuda.synchronize()
        self.rates.append(decisions / (time.perf_counter() - began))
        self.rates_a_core.append(decisions / (time.process_time() - worked))

    def figures(self) -> dict[str, int]:
        """The medians of its turns."""
        clock = {self.name: round(statistics.median(self.rates))}
        if self.device == "cuda":
            return clock
        return {**clock, f"{self.name}_a_core": round(statistics.median(self.rates_a_core))}


def ours(agent: Agent, replay: SequenceReplay, decisions: int) -> Callable[[], int]:
    """Our update, as the learner does it."""

    def update() -> int:
        batch = replay.sample(decisions)
        agent.update(batch)
        return batch.transitions

    return update


def plain(agent: Agent, replay: SequenceReplay, decisions: int) -> Callable[[], int]:
    """The plain update, from where that agent is."""
    other = PlainUpdate(agent)

    def update() -> int:
        batch = replay.sample(decisions)
        other.update(batch)
        return batch.transitions

    return update


def filled(agent: Agent, capacity: int = DECISIONS, priority: tuple[float, float] | None = None) -> Any:
    """A full replay of roads, routes and vehicles, with random numbers for everything else."""
    replay = make_replay(agent, capacity, LENGTH, 0, priority)
    random = np.random.default_rng(0)
    levels = agent.description.levels
    made = [synthetic_chunk(LENGTH, seed=seed) for seed in range(DIFFERENT)]
    for number in range(replay.slots):
        chunk = made[number % DIFFERENT]
        replay.insert(
            Sequence(
                images=chunk.images,
                motion=chunk.motion,
                actions={name: columns.actions for name, columns in chunk.levels.items()},
                rewards={name: columns.rewards for name, columns in chunk.levels.items()},
                initial_state={
                    level.name: random.normal(size=level.state_size).astype(np.float32) for level in levels
                },
                length=LENGTH,
                terminated=number % 50 == 0,
            )
        )
    return replay


def ppo() -> Callable[[], int]:
    """Stable-Baselines3's PPO with a full rollout buffer of 32 x 128 decisions; an update is one epoch."""
    from benchmarks.made_up_ppo import made_up_ppo

    model = made_up_ppo()

    def update() -> int:
        model.train()
        return model.rollout_buffer.buffer_size * model.rollout_buffer.n_envs * model.n_epochs

    return update


def contestants(shape: str, device: str, precision: torch.dtype) -> list[Contestant]:
    """Ours and the plain one on the CPU, and on a GPU if `device` is one, on batches of that shape."""
    decisions = int(np.prod([int(part) for part in shape.split("x")]))
    made = []
    for place in ["cpu", "cuda"] if device == "cuda" else ["cpu"]:

        def agent(precision: torch.dtype, place: str = place) -> Agent:
            settings = {"memory": "lstm" if "x" in shape else "none"}
            return make_agent(
                "athrl", settings, observation=Observation(32), device=place, precision=precision
            )

        used = precision if place == "cpu" else faster_precision(torch.device(place)).precision
        trained, start = agent(used), agent(torch.float32)
        replay = filled(trained)
        suffix = "" if place == "cpu" else "_cuda"
        made.append(Contestant(f"ours{suffix}", ours(trained, replay, decisions), place))
        made.append(Contestant(f"plain{suffix}", plain(start, replay, decisions), place))
    return made


def measured(shape: str, peer: Contestant | None, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure all contestants in turns on batches of one shape."""
    compared = contestants(shape, arguments.device, arguments.dtype)
    if peer is not None:
        peer.rates.clear()
        peer.rates_a_core.clear()
        compared.append(peer)
    for each in compared:
        each.warm_up()
    for _ in range(arguments.turns):
        for each in compared:
            each.turn(arguments.seconds)
    rates = {name: rate for each in compared for name, rate in each.figures().items()}
    ratios = {}
    for name, rate in rates.items():
        other, core, _ = name.partition("_a_core")
        if not name.startswith("ours"):
            ratios[f"ours_to_{name}"] = round(rates[f"ours{_place(other)}{core}"] / rate, 2)
    return {"batch": shape, **rates, **ratios}


def _place(name: str) -> str:
    return "_cuda" if name.endswith("_cuda") else ""


def sampling() -> dict[str, float]:
    """Milliseconds for a batch of 512 decisions as images, out of more than any cache holds: the median."""
    agent = make_agent("athrl")
    taken = {}
    for name, priority in (("uniform", None), ("prioritised", (0.6, 0.4))):
        replay = filled(agent, 100_000, priority)
        times = []
        for _ in range(300):
            began = time.perf_counter()
            replay.sample(512)
            times.append(1000 * (time.perf_counter() - began))
        taken[name] = round(statistics.median(times), 3)
    return taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", nargs="+", choices=SHAPES, default=SHAPES, metavar="SHAPE")
    parser.add_argument("--precision", choices=("auto", "float32", "bfloat16"), default="auto")
    parser.add_argument("--threads", type=int, default=1, help="of the CPU")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each turn")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--without-ppo", action="store_true", help="needs no stable-baselines3")
    parser.add_argument("--sampling", action="store_true", help="measure sampling alone")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    result: dict[str, Any] = {"torch": torch.__version__, "threads": arguments.threads}
    if not arguments.sampling:
        result |= _updates(arguments)
    result["sampling_ms"] = sampling()
    print(f"sampling 512 decisions: {result['sampling_ms']} ms")
    print(json.dumps(result))


def _updates(arguments: argparse.Namespace) -> dict[str, Any]:
    fastest = faster_precision(torch.device("cpu"))
    wanted = {"auto": fastest.precision, "float32": torch.float32, "bfloat16": torch.bfloat16}
    arguments.dtype = wanted[arguments.precision]
    peer = None if arguments.without_ppo else Contestant("sb3_ppo", ppo())
    rows = []
    for shape in arguments.batches:
        rows.append(measured(shape, peer, arguments))
        print("  ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    return {
        "precision": str(arguments.dtype).removeprefix("torch."),
        "bfloat16_speed": round(fastest.speed, 2),
        "gpu": torch.cuda.get_device_name() if arguments.device == "cuda" else None,
        "decisions_per_second": rows,
    }


if __name__ == "__main__":
    main()
