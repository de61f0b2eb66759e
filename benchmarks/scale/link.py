"""The lines between networks: packets arrive after a delay, and some are lost.

A line is a pair of TUN interfaces; what enters one leaves the other. The kernel's netem does the same, but
many kernels come without it. Arguments: seconds of delay in each direction, share of packets that are lost,
and the names of the interfaces, two for each line. Prints "ready" when they exist, carries packets from a
line of input, by when they have to be up, until its input is closed, and then prints a JSON object: `busy`,
its seconds of a core, and `packets` and `lost`.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import random
import select
import struct
import sys
import time
from collections import deque

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_MOST_BYTES = 65_536
_IN_A_ROW = 64
"""Packets that are read from one interface before others get their turn."""
_IDLE_SECONDS = 0.5


def interface(name: str) -> int:
    """Make a TUN interface; return the descriptor at which its packets are read and written.

    Raises:
        OSError: this machine gives none, or the name is taken.
    """
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH", name.encode(), _IFF_TUN | _IFF_NO_PI))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


class Lines:
    """Pairs of interfaces, and the packets that are on their way between them."""

    def __init__(self, names: list[str], delay: float, loss: float) -> None:
        ends = [interface(name) for name in names]
        self._other = {end: ends[number ^ 1] for number, end in enumerate(ends)}
        self._delay, self._loss = delay, loss
        # The delay is the same for all, so that the first in is the first out.
        self._under_way: deque[tuple[float, int, bytes]] = deque()
        self.packets = self.lost = 0

    def carry(self, until: int) -> None:
        """Carry packets until the descriptor `until` has something to say."""
        while True:
            due = self._under_way[0][0] - time.monotonic() if self._under_way else _IDLE_SECONDS
            readable, _, _ = select.select([until, *self._other], [], [], max(0.0, due))
            if until in readable:
                return
            for end in readable:
                self._take(end)
            self._deliver()

    def _take(self, end: int) -> None:
        for _ in range(_IN_A_ROW):
            try:
                packet = os.read(end, _MOST_BYTES)
            except BlockingIOError:
                return
            self.packets += 1
            if random.random() < self._loss:
                self.lost += 1
            else:
                self._under_way.append((time.monotonic() + self._delay, self._other[end], packet))

    def _deliver(self) -> None:
        now = time.monotonic()
        while self._under_way and self._under_way[0][0] <= now:
            _, end, packet = self._under_way.popleft()
            with contextlib.suppress(OSError):  # the interface is not up yet, or any more
                os.write(end, packet)


def main(delay: str, loss: str, *names: str) -> None:
    """Carry packets until the input is closed."""
    lines = Lines(list(names), float(delay), float(loss))
    print("ready", flush=True)
    os.read(sys.stdin.fileno(), 1)
    lines.carry(sys.stdin.fileno())
    print(json.dumps({"busy": time.process_time(), "packets": lines.packets, "lost": lines.lost}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
