"""Key expressions of a run, all under `athrl/<run>/`, and the incarnations that distinguish restarts."""

from __future__ import annotations

import functools
import hashlib
import re
import time
from dataclasses import dataclass
from datetime import UTC, datetime

from athrl_protocol.errors import InvalidMessage, ProtocolError

CLOCK_DIFFERENCE_SECONDS = 86_400.0
"""How far the clock of another machine may be ahead: even that of a machine with a wrong time zone."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,126}")


@functools.lru_cache(maxsize=1024)  # every chunk checks the same few names
def check_name(kind: str, name: str) -> str:
    """Return `name` if it can be a part of a key, else raise ProtocolError."""
    if not is_name(name):
        raise ProtocolError(
            f"{kind} {name!r} cannot be used: letters, digits, '.', '_' and '-' only, a letter or digit first"
        )
    return name


def is_name(name: str) -> bool:
    """Return whether a text can be a role or a name in a key, as `check_name` requires it."""
    return _NAME.fullmatch(name) is not None


def name_of_town(town: str) -> str:
    """Return the name of a town in a key: its name, or the end of a map's path and a hash."""
    if is_name(town):
        return town
    end = re.sub(r"[^A-Za-z0-9_.-]", "_", town.rpartition("/")[2])[-64:]
    return f"map-{hashlib.sha256(town.encode(errors='surrogatepass')).hexdigest()[:12]}-{end}"


def new_incarnation() -> int:
    """Return a number for this start of a process, larger than that of every earlier start (unix ns)."""
    return time.time_ns()


def check_incarnation(what: str, incarnation: int, now: float) -> None:
    """Refuse an incarnation from the future: it would stay the newest for ever.

    Args:
        what: names the message and its sender.
        incarnation: as `new_incarnation` returns it.
        now: unix seconds.

    Raises:
        InvalidMessage: it begins more than `CLOCK_DIFFERENCE_SECONDS` after `now`.
    """
    if incarnation / 1e9 <= now + CLOCK_DIFFERENCE_SECONDS:
        return
    began, current = (f"{datetime.fromtimestamp(at, UTC):%Y-%m-%d %H:%M}" for at in (incarnation / 1e9, now))
    raise InvalidMessage(
        "incarnation",
        f"{what}: incarnation {incarnation} begins at {began}, should be at most a day after {current} UTC, "
        "the time here: set the clocks",
    )


@dataclass(frozen=True)
class Keys:
    """The keys of one run.

    Raises:
        ProtocolError: a run, role or name cannot be part of a key.
    """

    run: str

    def __post_init__(self) -> None:
        check_name("run name", self.run)

    @property
    def _root(self) -> str:
        return f"athrl/{self.run}"

    @property
    def run_file(self) -> str:
        """The run file, served by the learner."""
        return f"{self._root}/run-file"

    @property
    def changes(self) -> str:
        """What was changed in the run's settings, served by the learner."""
        return f"{self._root}/changes"

    def free_name(self, role: str) -> str:
        """Names for services of a role that have none, given by the learner."""
        return f"{self._root}/free-name/{check_name('role', role)}"

    @property
    def policy(self) -> str:
        """The newest policy."""
        return f"{self._root}/policy"

    @property
    def state(self) -> str:
        """The state of the run."""
        return f"{self._root}/state"

    def evaluation(self, name: str, driver: str, town: str) -> str:
        """Results of one driver in one town, scored by the evaluator `name`."""
        who = f"{check_name('name', name)}/{check_name('driver', driver)}"
        return f"{self._root}/evaluation/{who}/{name_of_town(town)}"

    def experience(self, actor: str) -> str:
        """The actor's chunks."""
        return f"{self._root}/experience/{check_name('actor', actor)}"

    def metrics(self, role: str, name: str) -> str:
        """Metrics of one service."""
        return f"{self._root}/metrics/{check_name('role', role)}/{check_name('name', name)}"

    def alive(self, role: str, name: str) -> str:
        """Liveliness token of one service."""
        return f"{self._root}/alive/{check_name('role', role)}/{check_name('name', name)}"

    def live(self, role: str, name: str) -> str:
        """Live frames of one service."""
        return f"{self._root}/live/{check_name('role', role)}/{check_name('name', name)}"

    def metrics_of(self, role: str) -> str:
        """Matches the metrics of every service of a role."""
        return f"{self._root}/metrics/{check_name('role', role)}/*"

    def alive_of(self, role: str) -> str:
        """Matches the token of every service of a role."""
        return f"{self._root}/alive/{check_name('role', role)}/*"

    def live_of(self, role: str) -> str:
        """Matches the frames of every service of a role."""
        return f"{self._root}/live/{check_name('role', role)}/*"

    @property
    def every_evaluation(self) -> str:
        """Matches the results of every driver in every town."""
        return f"{self._root}/evaluation/*/*/*"

    @property
    def every_experience(self) -> str:
        """Matches the chunks of every actor."""
        return f"{self._root}/experience/*"

    @property
    def every_metrics(self) -> str:
        """Matches the metrics of every service."""
        return f"{self._root}/metrics/*/*"

    @property
    def every_alive(self) -> str:
        """Matches the token of every service."""
        return f"{self._root}/alive/*/*"

    @property
    def every_live(self) -> str:
        """Matches the frames of every service."""
        return f"{self._root}/live/*/*"


EVERY_RUN_FILE = "athrl/*/run-file"
PROBE_RUN_FILE = "athrl/-/run-file"
"""No run has this name; every client that may query run files may query this key."""


HOST_ROLE = "actor-host"
"""The role of a second token of each actor, whose name is that of its host and process."""


def run_of(key: str) -> str:
    """Return the run to which a key belongs."""
    return key.split("/")[1]


def role_and_name_of(key: str) -> tuple[str, str]:
    """Return role and name from a key of metrics, tokens or frames."""
    role, name = key.split("/")[3:5]
    return role, name
