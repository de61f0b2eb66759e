"""Key expressions of a run, all under `athrl/<run>/`, and the incarnations that tell restarts apart."""

from __future__ import annotations

import functools
import hashlib
import re
import time
from dataclasses import dataclass

from athrl_protocol.errors import ProtocolError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,126}")


@functools.lru_cache(maxsize=1024)  # every chunk asks for the same few
def check_name(kind: str, name: str) -> str:
    """Return `name` if it can be a part of a key, else raise ProtocolError."""
    if _NAME.fullmatch(name) is None:
        raise ProtocolError(
            f"{kind} {name!r} cannot be used: letters, digits, '.', '_' and '-' only, a letter or digit first"
        )
    return name


def name_of_town(town: str) -> str:
    """Return what stands for a town in a key: its name, or of a map's path the end and a hash."""
    if _NAME.fullmatch(town) is not None:
        return town
    end = re.sub(r"[^A-Za-z0-9_.-]", "_", town.rpartition("/")[2])[-64:]
    return f"map-{hashlib.sha256(town.encode(errors='surrogatepass')).hexdigest()[:12]}-{end}"


def new_incarnation() -> int:
    """Return a number for this start of a process, larger than that of every earlier start (unix ns)."""
    return time.time_ns()


@dataclass(frozen=True)
class Keys:
    """The keys of one run.

    Raises:
        ProtocolError: a run, role or name that cannot be part of a key.
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
        """Where the actor's chunks go."""
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
NOBODYS_RUN_FILE = "athrl/-/run-file"
"""No run has this name; all that may ask for run files may ask for it."""


def run_of(key: str) -> str:
    """Return the run to which a key belongs."""
    return key.split("/")[1]


def role_and_name_of(key: str) -> tuple[str, str]:
    """Return role and name from a key of metrics, tokens or frames."""
    role, name = key.split("/")[3:5]
    return role, name
