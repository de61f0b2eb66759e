"""What the learner's log says about the run: progress once a minute, and at the end all drivers' scores."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from athrl_protocol import EvaluationResult, Phase, RunState
from athrl_spaces.wording import counted

log = logging.getLogger(__name__)

#: Seconds between two lines of progress.
INTERVAL = 60.0

#: Drivers whose results are kept: their names come from other processes.
MOST_DRIVERS = 50

#: The scores of a driver in words: their names in a result, and the words.
_RETURN = (("return_mean", "return_ci95"), "return {:.0f} ± {:.0f}")
_SCORES = (
    (("episodes",), "{:.0f} episodes"),
    _RETURN,
    (("speed_mps",), "{:.2f} m/s"),
    (("distance_m",), "{:.0f} m"),
    (("collision_rate",), "collisions {:.0%}"),
    (("off_lane_rate",), "off lane {:.0%}"),
    (("full_episode_rate",), "full {:.0%}"),
    (("driving_score",), "score {:.2f}"),
)


class ProgressLog:
    """Collects results of evaluations, and logs them with the progress of the run."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told_at = clock()
        self._actors_came = False
        self._newest: dict[str, EvaluationResult] = {}  # of each driver
        self._lock = threading.Lock()

    def add(self, result: EvaluationResult) -> None:
        """Note a result, of a new driver only if there are not many; may be called from another thread."""
        with self._lock:
            if result.driver in self._newest or len(self._newest) < MOST_DRIVERS:
                self._newest[result.driver] = result

    def report(self, state: RunState, metrics: Mapping[str, float]) -> None:
        """Log the progress if that is due, or when the first actor has come; called once a second.

        `metrics` are those of this report: `actors`, `environment_steps_per_second`, `updates_per_second`.
        """
        now, came = self._clock(), metrics["actors"] > 0 and not self._actors_came
        if not came and now - self._told_at < INTERVAL:
            return
        self._told_at, self._actors_came = now, self._actors_came or came
        with self._lock:
            result = self._newest.get("policy")
        log.info("%s", progress_line(state, metrics, result))

    def begin_closing(self) -> None:
        """Forget the results so far: those of the closing comparison follow."""
        with self._lock:
            self._newest.clear()

    def tell_closing(self) -> None:
        """Log the results since `begin_closing`, a line for each driver."""
        with self._lock:
            results = list(self._newest.values())
        if not results:
            log.info("the run ends without a closing comparison: no evaluator made one")
        for result in results:
            for line in closing_lines(result):
                log.info("%s", line)


def with_silent_actors(state: RunState, actors: int) -> RunState:
    """The state with what its first actors may be doing, while they have sent nothing yet."""
    if state.phase is not Phase.WARMING_UP or state.environment_steps or not actors:
        return state
    have = f"{counted(actors, 'actor')} {'has' if actors == 1 else 'have'}"
    silent = f"{have} joined and sent nothing yet: at its first start an actor compiles for about a minute"
    return replace(state, waiting=f"{state.waiting}; {silent}" if state.waiting else silent)


def progress_line(state: RunState, metrics: Mapping[str, float], result: EvaluationResult | None) -> str:
    """The progress of the run in one line, with the policy's newest result if there is one."""
    actors, phase = int(metrics["actors"]), state.phase.name.lower().replace("_", " ")
    parts = [
        f"{phase}: {state.environment_steps} of {state.environment_steps_target} environment steps "
        f"({metrics['environment_steps_per_second']:.0f}/s)",
        f"{state.updates} updates ({metrics['updates_per_second']:.1f}/s)",
        f"policy {state.policy_version}",
        counted(actors, "actor") if actors else "no actors",
    ]
    if result is not None:
        scores = _in_words(result.scores, _RETURN)
        parts += [f"{words} by policy {result.policy_version}" for words in scores]
    return ", ".join(parts) + (f"; {state.waiting}" if state.waiting else "")


def closing_lines(result: EvaluationResult) -> Iterator[str]:
    """The scores of one driver in the closing comparison: over all towns, then in each of several."""
    name = f"policy {result.policy_version}" if result.driver == "policy" else result.driver
    of_place: dict[str, dict[str, float]] = {"": {}}
    for score, value in result.scores.items():
        town, _, of_town = score.rpartition("/")
        of_place.setdefault(town, {})[of_town] = value
    for town, scores in of_place.items():
        yield f"{name} in {town or result.town}: {', '.join(_in_words(scores, *_SCORES))}"


def _in_words(scores: Mapping[str, float], *wanted: tuple[tuple[str, ...], str]) -> Iterator[str]:
    """The wanted scores, without those that are missing."""
    for names, words in wanted:
        if all(name in scores for name in names):
            yield words.format(*(scores[name] for name in names))
