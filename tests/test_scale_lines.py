"""Lines between racks: packets take their time, some are lost, all are counted; and what plans follow."""

from __future__ import annotations

import socket
import subprocess
import sys
import time

import pytest

from benchmarks.scale.connections import Connected
from benchmarks.scale.driving import Driven
from benchmarks.scale.flood import WAYS, Flooded
from benchmarks.scale.plan import bounds, need
from benchmarks.scale.racks import Rack, racks, why_not

DELAY, BYTES = 0.02, 300_000

needs_racks = pytest.mark.skipif(bool(why_not()), reason=why_not())

FLOODED = [
    Flooded(way, 1000, 100.0, 0.02, router, 800.0)
    for way, router in zip(WAYS, (0.0, 0.004, 0.005), strict=True)
]
DRIVEN = Driven(16, 1000, 100.0, 0.5, 500.0, 1e6, 10, 1_000_000)
CONNECTED = Connected(200, 0.25, 0.125)


@needs_racks
def test_bytes_arrive_whole_after_the_delay_though_packets_are_lost() -> None:
    with racks(2, DELAY, 0.05) as (made, line):
        for rack in made:
            took = sent(rack)
            assert took >= 2 * DELAY  # a connection takes one way there and one back
            assert rack.bytes_received() > BYTES
    assert line.lost > 0
    assert line.packets > 2 * BYTES / 1500


def sent(rack: Rack) -> float:
    """Send bytes from a rack to here; return how long opening the connection took, in seconds."""
    with socket.create_server((rack.here, 0)) as server:
        server.settimeout(30)
        port = server.getsockname()[1]
        script = (
            "import socket, time; began = time.monotonic();"
            f"s = socket.create_connection(({rack.here!r}, {port}), 30);"
            f"print(time.monotonic() - began); s.sendall(bytes({BYTES})); s.close()"
        )
        command = [*rack.within, sys.executable, "-c", script]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            connection, _ = server.accept()
            with connection:
                connection.settimeout(30)
                came, deadline = 0, time.monotonic() + 60
                while block := connection.recv(65_536):
                    came += len(block)
                    assert time.monotonic() < deadline
            assert process.stdout is not None
            took = float(process.stdout.readline())
    assert came == BYTES
    return took


def test_needs_grow_in_proportion_and_what_is_full_first_is_named() -> None:
    few, many = (need(actors, 100.0, FLOODED, DRIVEN, CONNECTED) for actors in (16, 10_000))
    assert few.breaks == ""
    assert many.learner_cores == pytest.approx(20.0)  # a million decisions at 0.02 s for 1,000
    assert many.router_cores == pytest.approx(4.0)
    assert many.line_in == pytest.approx(0.4)  # 500 bytes each
    assert many.line_out == pytest.approx(8.0)  # 1 MB/s to each of 10,000
    assert many.line_out_routed == pytest.approx(many.line_out / 50)
    assert many.breaks == "the core that takes in"


def test_bounds_follow_from_costs() -> None:
    rows = {row[0]: row[1] for row in bounds(FLOODED, DRIVEN, CONNECTED)}
    assert rows["one learner, a core for intake"] == 50_000
    assert rows["one router, a core"] == 250_000
    assert rows["a line of 10 Gbit/s, experience"] == 2_500_000
