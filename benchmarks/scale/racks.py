"""Racks: network namespaces, each with one line to this machine's own network, where the learner is."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

_QUEUE = 20_000
"""Packets that wait for the process which carries them: it shares the cores with those who send."""
_PATIENCE = 30.0


@dataclass(frozen=True)
class Rack:
    """A network namespace.

    Attributes:
        within: words before a command line that is to run inside.
        here: this machine's address as seen from inside.
        own: its address as seen from this machine.
        interface: this machine's end of the line.
    """

    within: tuple[str, ...]
    here: str
    own: str
    interface: str

    def bytes_received(self) -> int:
        """Bytes that came from the rack, with the headers of IP and TCP."""
        return self._counter("rx_bytes")

    def bytes_sent(self) -> int:
        """Bytes that went to the rack, with the headers of IP and TCP."""
        return self._counter("tx_bytes")

    def _counter(self, name: str) -> int:
        return int(Path(f"/sys/class/net/{self.interface}/statistics/{name}").read_text())


@dataclass
class Line:
    """What the process that carries the packets counted; filled in at its end."""

    busy: float = 0.0
    packets: int = 0
    lost: int = 0


def why_not() -> str:
    """Why no racks can be made here, in one line; empty if they can."""
    if os.geteuid() != 0:
        return "network namespaces take root: run it as root"
    if shutil.which("ip") is None:
        return "the command `ip` is missing: apt-get install iproute2"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "/dev/net/tun is missing or may not be opened: load the kernel's module tun"
    probe = f"athrl-scale-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", probe], capture_output=True, text=True, timeout=_PATIENCE)
    if made.returncode != 0:
        return f"no network namespace can be made here: {made.stderr.strip()}"
    _ip("netns", "delete", probe)
    return ""


@contextmanager
def racks(count: int, delay: float, loss: float) -> Iterator[tuple[list[Rack], Line]]:
    """Make racks; a packet takes `delay` seconds each way, and a share of `loss` is lost.

    Yields the racks and the counts of their lines, which are complete when the block has ended.
    """
    mark, line = f"at{os.getpid() % 100_000}", Line()
    subnet = f"10.{100 + os.getpid() % 90}"  # another process may have racks as well
    names = [(f"{mark}h{number}", f"{mark}r{number}") for number in range(count)]
    words = [sys.executable, "-m", "benchmarks.scale.link", str(delay), str(loss)]
    with ExitStack() as stack:
        for _, there in names:
            _ip("netns", "add", _space(there))
            stack.callback(_ip, "netns", "delete", _space(there))
        carrier = subprocess.Popen(
            [*words, *(name for pair in names for name in pair)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # see `processes.athrl`
        )
        stack.callback(_end, carrier, line)
        if carrier.stdout.readline() != b"ready\n":
            sys.exit("the lines between racks could not be made: see the error above")
        made = [_rack(f"{subnet}.{number}", *pair) for number, pair in enumerate(names)]
        carrier.stdin.write(b"\n")
        carrier.stdin.flush()
        yield made, line


def _space(interface: str) -> str:
    return f"{interface}s"


def _rack(subnet: str, here: str, there: str) -> Rack:
    """Bring up both ends of a line, one of them in the rack's namespace."""
    space = _space(there)
    _ip("link", "set", there, "netns", space)
    for words, address, name in (((), f"{subnet}.1/30", here), (("-n", space), f"{subnet}.2/30", there)):
        _ip(*words, "address", "add", address, "dev", name)
        _ip(*words, "link", "set", name, "up", "txqueuelen", str(_QUEUE))
    _ip("-n", space, "link", "set", "lo", "up")
    return Rack(("ip", "netns", "exec", space), f"{subnet}.1", f"{subnet}.2", here)


def _end(carrier: subprocess.Popen[bytes], line: Line) -> None:
    try:
        counted, _ = carrier.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        carrier.kill()
        carrier.wait(_PATIENCE)
        return
    if carrier.returncode == 0:
        vars(line).update(json.loads(counted))


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=_PATIENCE)
