"""What the learner shows to Prometheus: its own metrics, all actors' and the newest scores."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from athrl_protocol import RunFile
from athrl_protocol.monitoring.endpoint import serve_metrics
from athrl_protocol.monitoring.figures import ScoreFigures, ServiceFigures
from athrl_protocol.monitoring.fleet import ActorFigures
from athrl_protocol.monitoring.table import LEARNER


@dataclass(frozen=True)
class Exposition:
    """What is shown, each by whom it is given.

    Attributes:
        learner: the learner's metrics.
        actors: each actor's reports.
        scores: the results of evaluations.
    """

    learner: ServiceFigures
    actors: ActorFigures
    scores: ScoreFigures


def open_exposition(stack: contextlib.ExitStack, run_file: RunFile) -> Exposition:
    """Show at `metrics.listen`, if the run has one, what is given from now on; ends with `stack`.

    Raises:
        ProtocolError: it cannot listen there.
    """
    labels = {"run": run_file.run.name}
    shown = Exposition(ServiceFigures(LEARNER, labels), ActorFigures(labels), ScoreFigures(labels))
    stack.enter_context(serve_metrics(run_file.metrics.listen, shown.learner, shown.actors, shown.scores))
    return shown
