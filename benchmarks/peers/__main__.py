"""Our default run beside Stable-Baselines3's PPO, TD3 and SAC: the same town, cores and wall time.

`python -m benchmarks.peers --minutes 10` trains one after the other, each in separate processes on the same
cores, and drives each policy greedily on the same 100 held-out episodes, with seeds from 700000.
`--with torchrl,rllib` adds their PPO if they can be installed, each in its own environment.

Only training counts as time: the clock starts before the first decision (of our run: with the last
moment at which the learner had none) and ends after the last update; starting, compiling and intermediate
scoring do not count. Ours is an unchanged `athrl train`, with actors, Zenoh and log, but its evaluator does
not score during training. Its number of decisions, which determines its schedules, is `--ours-steps`, or is
derived from a short run before. The peers' schedules depend on the clock. Nothing is selected by scores: the
table has the last policies, and the JSON has all settings.

`--out` gets peers.json, peers.png, curves.csv, a NAME.json for each and the run's folder. With `--resume` an
existing NAME.json of the same comparison, and of ours with the same settings, is used instead of measuring
again. The last printed line is peers.json in one line. The machine should be idle otherwise.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.peers import ours
from benchmarks.peers.chart import TITLES, draw, write_curves
from benchmarks.peers.comparison import Comparison, Learned
from benchmarks.peers.installation import PACKAGES, PEER_OF, NotInstalled, install
from benchmarks.peers.waiting import faster_waiting

CONTESTANTS = ("ours", "sb3_ppo", "sb3_td3", "sb3_sac")
ROOT = Path(__file__).parents[2]


class PeerFailed(RuntimeError):  # noqa: N818  (the name says what happened)
    """A peer's process ended with an error; `str()` is one line."""


def main() -> None:
    """Measure, print, draw; exit code 1 if a contestant failed."""
    arguments = _arguments()
    cores = sorted(os.sched_getaffinity(0))[: arguments.cores]
    os.sched_setaffinity(0, cores)  # of this process and all that it starts
    comparison = Comparison(
        town=arguments.town,
        vehicles=arguments.vehicles,
        seconds=60.0 * arguments.minutes,
        cores=len(cores),
        seed=arguments.seed,
        points=arguments.points,
        episodes=arguments.episodes,
    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    try:
        rule_based = ours.evaluate(comparison, "rule-based")
    except ours.RunFailed as failure:  # for instance an unknown town
        print(failure, file=sys.stderr)
        sys.exit(2)
    with ExitStack() as stack:
        found = _measure_all(comparison, arguments, _pythons(arguments, stack))
    learned = {name: one for name, one in found.items() if isinstance(one, Learned)}
    facts = _facts(comparison, rule_based, found)
    (arguments.out / "peers.json").write_text(json.dumps(facts, indent=1) + "\n")
    if learned:
        draw(learned, rule_based, arguments.out / "peers.png")
        write_curves(learned, arguments.out / "curves.csv")
    _print_table(rule_based, learned)
    print(json.dumps(facts))
    if len(learned) < len(found):
        sys.exit(1)


def _measure_all(
    comparison: Comparison, arguments: argparse.Namespace, pythons: Mapping[str, Path]
) -> dict[str, Learned | str]:
    """Train one after the other; a failure is a line with the cause."""
    found: dict[str, Learned | str] = {}
    for name in [*arguments.only, *(name for name in pythons if name not in arguments.only)]:
        file = arguments.out / f"{name}.json"
        try:
            earlier = _earlier(file, comparison) if arguments.resume else None
            if earlier is not None and name == "ours":
                earlier = earlier if _as_asked(earlier, arguments.set, arguments.ours_steps) else None
            if earlier is not None:
                print(f"{TITLES[name]}: as in {file}", flush=True)
                found[name] = earlier
                continue
            print(f"{TITLES[name]}: {comparison.seconds:.0f} s of training", flush=True)
            if name == "ours":
                one = ours.learn(comparison, arguments.out, arguments.ours_steps, arguments.set)
                one.write(file)
            else:
                one = _train_peer(name, pythons.get(name, Path(sys.executable)), comparison, file)
            found[name] = one
        except (ours.RunFailed, PeerFailed) as failure:
            print(f"{TITLES[name]} failed: {failure}", file=sys.stderr, flush=True)
            found[name] = str(failure)
    return found


def _train_peer(name: str, python: Path, comparison: Comparison, file: Path) -> Learned:
    """Train a peer in a separate process; its libraries get as many threads as there are cores."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), str(comparison.cores))
    threads |= faster_waiting(comparison.cores)
    command = [
        *(str(python), "-m", "benchmarks.peers.worker"),
        *(name, json.dumps(asdict(comparison)), str(file.resolve())),
    ]
    log = file.with_suffix(".log")
    with log.open("w") as output:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env={**os.environ, **threads},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    if done.returncode != 0:
        lines = log.read_text(errors="replace").strip().splitlines() or ["without a word"]
        raise PeerFailed(f"ended with code {done.returncode}, see {log}: {lines[-1]}")
    learned = Learned.read(file)
    learned = replace(learned, remarks={**learned.remarks, **threads})
    learned.write(file)
    return learned


def _earlier(file: Path, comparison: Comparison) -> Learned | None:
    """An earlier result, if it is of the same comparison."""
    try:
        earlier = Learned.read(file)
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return earlier if earlier.comparison == comparison else None


def _as_asked(earlier: Learned, settings: Sequence[str], steps: int | None) -> bool:
    """Whether our run had these settings and, where a length is given, was to be as long."""
    remarks = earlier.remarks
    return remarks.get("settings") == list(settings) and steps in (None, remarks.get("decisions_wanted"))


def _pythons(arguments: argparse.Namespace, stack: ExitStack) -> dict[str, Path]:
    """The Python of each peer with its own environment; peers that cannot be installed are skipped."""
    pythons: dict[str, Path] = {}
    for library in arguments.others:
        folder = arguments.environments or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        print(f"installing {library} into {folder / library}", flush=True)
        try:
            pythons[PEER_OF[library]] = install(library, folder / library)
        except NotInstalled as reason:
            print(f"without {library}: {reason}", flush=True)
    return pythons


def _facts(
    comparison: Comparison, rule_based: Mapping[str, float], found: Mapping[str, Learned | str]
) -> dict[str, Any]:
    """Everything in one JSON object."""
    rows = {
        name: {"error": one} if isinstance(one, str) else {**one.points[-1].row(), "how": one.remarks}
        for name, one in found.items()
    }
    libraries = {name: version(name) for name in ("torch", "stable-baselines3", "gymnasium")}
    return {
        **asdict(comparison),
        "processor": _processor(),
        "python": platform.python_version(),
        "libraries": libraries,
        "rule_based": dict(rule_based),
        **rows,
    }


def _processor() -> str:
    """The processor's name as Linux tells it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _print_table(rule_based: Mapping[str, float], learned: Mapping[str, Learned]) -> None:
    rows: dict[str, Mapping[str, Any]] = {"rule-based driver": {"seconds": 0, "decisions": 0, **rule_based}}
    rows |= {TITLES[name]: one.points[-1].row() for name, one in learned.items()}
    print(f"{'who':<24}{'s':>7}{'decisions':>12}{'return':>15}{'collisions':>12}{'off lane':>10}{'full':>7}")
    for who, row in rows.items():
        interval = f"{row['return_mean']:.0f} +- {row['return_ci95']:.0f}"
        print(
            f"{who:<24}{row['seconds']:>7.0f}{row['decisions']:>12,}{interval:>15}"
            f"{row['collision_rate']:>12.0%}{row['off_lane_rate']:>10.0%}{row['full_episode_rate']:>7.0%}"
        )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=_positive, default=10.0, help="of training, for each")
    parser.add_argument("--cores", type=_whole(1), default=2, help="for each, of those given to us")
    parser.add_argument("--only", type=_names(CONTESTANTS), default=list(CONTESTANTS), metavar="NAME,NAME",
                        help=f"contestants: {', '.join(CONTESTANTS)}")  # fmt: skip
    parser.add_argument("--with", dest="others", type=_names(tuple(PACKAGES)), default=[],
                        metavar="NAME,NAME", help=f"others to compare: {', '.join(PACKAGES)}")  # fmt: skip
    parser.add_argument("--environments", type=Path, metavar="FOLDER",
                        help="folder of their environments; by default a temporary one")  # fmt: skip
    parser.add_argument("--seed", type=_whole(0), default=0)
    parser.add_argument("--town", default="town03", help="a town's name, or a map PATH.xodr")
    parser.add_argument("--vehicles", type=_whole(0), default=100)
    parser.add_argument("--points", type=_whole(1), default=10, help="of each curve")
    parser.add_argument("--episodes", type=_whole(2), default=100, help="that each policy is scored on")
    parser.add_argument("--ours-steps", type=_whole(1), help="our run's length in decisions")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="setting of our run that differs from the default")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("runs/peers"), metavar="FOLDER")
    parser.add_argument("--resume", action="store_true", help="measure only what --out does not hold yet")
    return parser.parse_args()


def _positive(text: str) -> float:
    if not 0 < (value := float(text)) < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _whole(least: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if int(text) < least:
            raise argparse.ArgumentTypeError(f"{text} is below {least}")
        return int(text)

    return read


def _names(known: tuple[str, ...]) -> Callable[[str], list[str]]:
    def read(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name} is none of {', '.join(known)}")
        return names

    return read


if __name__ == "__main__":
    main()
