"""Our default run through the real services: `athrl train`, watched from outside and stopped in time.

Learner, actors, Zenoh and the log of experience are as any user has them; the evaluator takes part but
scores nothing on the way, since the peers' scoring is not counted either. Instead the newest policy is laid
aside now and then, and scored after the run by `athrl evaluate`.
"""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from athrl.ports import free_address
from athrl.run_view import RunView
from athrl_protocol import LearnerNotFound, Phase, RunNotFound, RunState

from benchmarks.peers.comparison import Comparison, Learned, Point

CALIBRATION_SECONDS = 20.0
MARGIN = 0.97
"""Share of the decisions that the calibration promises: better a rate that has fallen a little early."""
START_SECONDS = 240.0
"""How long the services may take until the first decision, compilation included."""
STOP_SECONDS = 120.0
ENDLESS = 10**9
POLL_SECONDS = 0.1
SCORES = ("return_mean", "return_ci95", "collision_rate", "off_lane_rate", "full_episode_rate")


class RunFailed(RuntimeError):  # noqa: N818  (the name says what happened)
    """The command did not start or ended too early; `str()` is one line."""


@dataclass(frozen=True)
class Saved:
    """A copy of an intermediate policy."""

    seconds: float
    decisions: int
    file: Path


class LiveRun:
    """A run of `athrl train` whose clock starts with the first decision that the learner took in.

    The learner reports its state once a second: the clock starts at the last report without any decision,
    so it is fast by a second at most, never slow.
    """

    def __init__(self, view: RunView, process: subprocess.Popen[bytes], folder: Path, log: Path) -> None:
        self.folder = folder
        self._view, self._process, self._log = view, process, log
        self.began = self._wait_for_the_first_decision()

    @property
    def seconds(self) -> float:
        """Since the first decision."""
        return time.monotonic() - self.began

    def newest_state(self) -> RunState | None:
        """The newest state; raises RunFailed if the command ended before the run."""
        state = self._view.snapshot().state
        if self._process.poll() is not None and (state is None or state.phase is not Phase.FINISHED):
            raise RunFailed(f"athrl train ended with code {self._process.poll()}: {_last_line(self._log)}")
        return state

    def save(self, file: Path) -> Saved:
        """Copy the newest policy; raises RunFailed if there is none."""
        newest = self.folder / "policies" / "latest.onnx"
        for _ in range(50):  # the facts are renamed a moment before their policy
            try:
                facts = json.loads(newest.with_suffix(".json").read_bytes())
                content = newest.read_bytes()
            except OSError as error:
                raise RunFailed(f"the run has left no policy: {error}") from None
            if hashlib.sha256(content).hexdigest() == facts["sha256"]:
                file.write_bytes(content)
                return Saved(self.seconds, facts["environment_steps"], file)
            time.sleep(POLL_SECONDS)
        raise RunFailed(f"{newest} is not the policy of which {newest.with_suffix('.json').name} tells")

    def _wait_for_the_first_decision(self) -> float:
        deadline = time.monotonic() + START_SECONDS
        before = time.monotonic()
        while (state := self.newest_state()) is None or state.environment_steps == 0:
            before = time.monotonic()
            if before > deadline:
                raise RunFailed(f"no decision within {START_SECONDS:.0f} s: see {self._log}")
            time.sleep(POLL_SECONDS)
        return before


def learn(comparison: Comparison, folder: Path, steps: int | None, settings: Sequence[str]) -> Learned:
    """Train for the comparison's time and score the copied policies.

    `steps` is the run's length in decisions, over which rates and noise fall; without it a short run before
    tells how many fit. `settings` are overrides of the default run file, KEY=VALUE.

    Raises:
        RunFailed: the run did not reach its end.
    """
    folder.mkdir(parents=True, exist_ok=True)
    calibration = {} if steps else calibrate(comparison, folder, settings)
    target = steps or max(1, round(MARGIN * calibration["decisions_that_fit"]))
    saved: list[Saved] = []
    with _started(comparison, folder, "ours", target, settings) as run:
        while (state := run.newest_state()) is None or state.phase not in (Phase.FINISHED, Phase.DRAINING):
            share = (len(saved) + 1) / comparison.points
            if share < 1.0 and run.seconds >= share * comparison.seconds:
                saved.append(run.save(folder / f"ours-{len(saved) + 1}.onnx"))
            if run.seconds >= comparison.seconds:
                break
            time.sleep(POLL_SECONDS)
        last = run.save(folder / "ours.onnx")
        finished = state is not None and state.phase is Phase.FINISHED
        decisions = state.environment_steps if state is not None else last.decisions
    points = [Point(one.seconds, one.decisions, evaluate(comparison, one.file)) for one in saved]
    points.append(Point(last.seconds, decisions, evaluate(comparison, last.file)))
    remarks = {"decisions_wanted": target, "finished": finished, "settings": list(settings), **calibration}
    return Learned(comparison, points, remarks)


def calibrate(comparison: Comparison, folder: Path, settings: Sequence[str]) -> dict[str, float]:
    """How many decisions fit into the time, from the rate of a run that has just begun to train."""
    seconds = min(CALIBRATION_SECONDS, comparison.seconds)
    with _started(comparison, folder, "calibration", ENDLESS, settings) as run:
        while (state := run.newest_state()) is None or state.updates == 0:
            if run.seconds > START_SECONDS:
                raise RunFailed(f"no update within {START_SECONDS:.0f} s")
            time.sleep(POLL_SECONDS)
        news = [(run.seconds, state.environment_steps)]
        while run.seconds - news[0][0] < seconds or len(news) < 2:
            state = run.newest_state() or state
            if state.environment_steps != news[-1][1]:
                news.append((run.seconds, state.environment_steps))
            time.sleep(POLL_SECONDS)
    (began, first), (ended, last) = news[0], news[-1]
    rate = (last - first) / (ended - began)
    fit = first + rate * max(0.0, comparison.seconds - began)
    return {
        "warm_up_seconds": round(began, 1),
        "decisions_per_second": round(rate, 1),
        "decisions_that_fit": round(fit),
    }


def evaluate(comparison: Comparison, driver: Path | str) -> dict[str, float]:
    """Score a policy file or a reference driver with `athrl evaluate` on the comparison's episodes."""
    words = [
        *("evaluate", "--policy", str(driver), "--town", comparison.town, "--json"),
        *("--episodes", str(comparison.episodes), "--seed", str(comparison.first_seed)),
        *("--set", f"environment.vehicles={comparison.vehicles}"),
    ]
    done = subprocess.run(_athrl(*words), stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["without a word"]
        raise RunFailed(f"athrl evaluate --policy {driver} ended with code {done.returncode}: {lines[-1]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return {name: float(found[name]) for name in SCORES}


@contextmanager
def _started(
    comparison: Comparison, folder: Path, name: str, steps: int, settings: Sequence[str]
) -> Iterator[LiveRun]:
    """A run that is already driving; inside the block it continues, after the block it has ended."""
    name = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    address = free_address()
    ours = {
        "run.folder": folder / "runs",
        "run.seed": comparison.seed + 1,
        "run.environment_steps": steps,
        "environment.towns": comparison.town,
        "environment.vehicles": comparison.vehicles,
        "evaluator.seconds_between": ENDLESS,
        "evaluator.final_episodes": 2,
        "network.listen": address,
    }
    overrides = [*(f"{key}={value}" for key, value in ours.items()), *settings]
    words = ["train", "--name", name, "--viewer-port", "0"]
    log = folder / f"{name}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            _athrl(*words, *(word for override in overrides for word in ("--set", override))),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    try:
        with ExitStack() as stack:
            view = _view(process, address, name, log, stack)
            yield LiveRun(view, process, folder / "runs" / name, log)
    finally:
        _stop(process)


def _view(process: subprocess.Popen[bytes], address: str, name: str, log: Path, stack: ExitStack) -> RunView:
    """Wait until the learner answers; raises RunFailed if it does not."""
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline and process.poll() is None:
        try:
            return stack.enter_context(RunView(address, name, timeout=1.0))
        except (LearnerNotFound, RunNotFound):
            time.sleep(POLL_SECONDS)
    raise RunFailed(f"athrl train did not start: {_last_line(log)}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Ask the command to drain, which writes the policy and a checkpoint, and wait for its end."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)  # the second one ends it, and all it has started, at once
        process.wait(STOP_SECONDS)


def _athrl(*words: str) -> list[str]:
    return [sys.executable, "-m", "athrl", *words]


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "without a word"
