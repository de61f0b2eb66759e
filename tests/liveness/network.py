"""A separate network for some services, whose only connection to the others can be cut."""

from __future__ import annotations

import os
import shutil
import subprocess
import uuid
from types import TracebackType
from typing import Self


def why_not() -> str:
    """Return why networks cannot be made here; empty if they can."""
    if os.geteuid() != 0:
        return "making a network takes root"
    missing = [program for program in ("ip", "iptables") if shutil.which(program) is None]
    if missing:
        return f"{' and '.join(missing)} not installed"
    probe = f"athrl{uuid.uuid4().hex[:6]}"
    made = subprocess.run(["ip", "netns", "add", probe], capture_output=True, text=True)
    if made.returncode != 0:
        return f"no network can be made here: {made.stderr.strip()}"
    subprocess.run(["ip", "netns", "delete", probe], check=True)
    return ""


class Network:
    """A network namespace with a pair of interfaces to this one; a context manager.

    Attributes:
        here: this machine's address as seen from inside.
        within: words before a command line that is to run inside.
    """

    def __init__(self) -> None:
        mark = uuid.uuid4().hex[:6]
        number = int(mark, 16)
        subnet = f"10.{200 + number % 50}.{number // 50 % 256}"
        self.here, self._there = f"{subnet}.1", f"{subnet}.2"
        self._name, self._outer, self._inner = f"athrl{mark}", f"ath{mark}o", f"ath{mark}i"
        self.within = ("ip", "netns", "exec", self._name)

    def __enter__(self) -> Self:
        _run("ip", "netns", "add", self._name)
        try:
            _run("ip", "link", "add", self._outer, "type", "veth", "peer", "name", self._inner)
            _run("ip", "link", "set", self._inner, "netns", self._name)
            _run("ip", "address", "add", f"{self.here}/24", "dev", self._outer)
            _run("ip", "link", "set", self._outer, "up")
            _run(*self.within, "ip", "address", "add", f"{self._there}/24", "dev", self._inner)
            for device in ("lo", self._inner):
                _run(*self.within, "ip", "link", "set", device, "up")
        except subprocess.CalledProcessError:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        subprocess.run(["ip", "link", "delete", self._outer], capture_output=True)
        subprocess.run(["ip", "netns", "delete", self._name], capture_output=True)

    def cut(self) -> None:
        """Drop everything that goes in or out, without a word to either end."""
        for chain, direction in (("INPUT", "-i"), ("OUTPUT", "-o")):
            _run(*self.within, "iptables", "-I", chain, direction, self._inner, "-j", "DROP")

    def mend(self) -> None:
        """Let everything through again."""
        for chain in ("INPUT", "OUTPUT"):
            _run(*self.within, "iptables", "-F", chain)


def _run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)
