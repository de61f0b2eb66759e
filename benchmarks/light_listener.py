"""Hears the metrics of all services of a run, as an evaluator or a viewer does.

Argument: address. Says "ready" when it listens; for each line of its input it says how many actors it has
heard.
"""

from __future__ import annotations

import sys

from athrl_protocol import MetricsReport, MetricsSubscriber, open_session

from benchmarks.light_crowd import RUN

_PATIENCE = 60.0


def main(address: str) -> None:
    """Listen until the input is closed."""
    heard: set[str] = set()

    def hear(report: MetricsReport) -> None:
        if report.role == "actor":
            heard.add(report.name)

    with open_session(connect=address, timeout=_PATIENCE) as session, MetricsSubscriber(session, RUN, hear):
        print("ready", flush=True)
        for _ in sys.stdin:
            print(len(heard), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
