"""Receives the metrics of all services of a run, as an evaluator or a viewer does.

Argument: address. Prints "ready" when it listens; for each line of its input it prints how many actors have
reported.
"""

from __future__ import annotations

import sys

from athrl_protocol import MetricsReport, MetricsSubscriber, open_session

from benchmarks.light_crowd import RUN

_PATIENCE = 60.0


def main(address: str) -> None:
    """Listen until the input is closed."""
    reported: set[str] = set()

    def note(report: MetricsReport) -> None:
        if report.role == "actor":
            reported.add(report.name)

    with open_session(connect=address, timeout=_PATIENCE) as session, MetricsSubscriber(session, RUN, note):
        print("ready", flush=True)
        for _ in sys.stdin:
            print(len(reported), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
