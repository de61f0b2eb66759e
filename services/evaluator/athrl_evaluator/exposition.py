"""What the evaluator shows to Prometheus: its own metrics and the newest scores of each driver."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass

from athrl_protocol.monitoring.endpoint import serve_metrics
from athrl_protocol.monitoring.figures import ScoreFigures, ServiceFigures
from athrl_protocol.monitoring.table import EVALUATOR


@dataclass(frozen=True)
class Exposition:
    """What is shown: the evaluator's metrics, and the results that it made."""

    evaluator: ServiceFigures
    scores: ScoreFigures


def open_exposition(stack: ExitStack, run: str, listen: str) -> Exposition:
    """Show at an address, if it is not empty, what is given from now on; ends with `stack`.

    Raises:
        ProtocolError: it cannot listen there.
    """
    labels = {"run": run}
    shown = Exposition(ServiceFigures(EVALUATOR, labels), ScoreFigures(labels))
    stack.enter_context(serve_metrics(listen, shown.evaluator, shown.scores))
    return shown
