"""The panel of a run in a terminal, and the same as one plain line."""

from __future__ import annotations

import math

from athrl_protocol import Phase
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from athrl.run_view import RunSnapshot


def draw(snapshot: RunSnapshot, where_to_look: list[str]) -> RenderableType:
    """Draw a run; `where_to_look` are lines for the foot of the panel.

    What services said is `Text`, in which brackets are no markup.
    """
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="bold", no_wrap=True)
    rows.add_column()
    rows.add_row("environment steps", _progress(snapshot))
    rows.add_row("learner", Text(_learner(snapshot)))
    if snapshot.silence:
        rows.add_row("", Text(snapshot.silence, style="yellow"))
    for name, values in snapshot.of_role("actor").items():
        rows.add_row(f"actor {name}", Text(_actor(snapshot, name, values)))
    if not snapshot.of_role("actor") and not snapshot.finished:
        rows.add_row("actors", Text("none present", style="yellow"))
    if routers := snapshot.of_role("router"):
        rows.add_row("routers" if len(routers) > 1 else "router", ", ".join(routers))
    rows.add_row("evaluator", _evaluations(snapshot))
    if snapshot.warnings:
        rows.add_row("warnings", Text(" · ".join(snapshot.warnings), style="yellow"))
    for line in snapshot.changes[-CHANGES_SHOWN:]:
        rows.add_row("changed", Text(line))
    foot = [Text(line, style="dim") for line in where_to_look]
    return Panel(Group(rows, *foot), title=f"athrl: run {snapshot.settings.run.name}", title_align="left")


def plain_line(snapshot: RunSnapshot) -> str:
    """Return the run's progress as one line, for output that is no terminal."""
    state = snapshot.state
    if state is None:
        return "waiting for the learner's state"
    actors = snapshot.of_role("actor")
    parts = [
        f"steps {state.environment_steps}/{state.environment_steps_target}",
        f"{_number(snapshot.steps_per_second)}/s",
        f"ETA {_eta(snapshot)}",
        f"updates {state.updates}",
        f"replay {_number(snapshot.learner_metric(REPLAY))}",
        f"policy {state.policy_version} lag {_number(snapshot.learner_metric('policy_lag'))}",
        f"actors {len(actors)}",
        f"return {_number(_mean(actors, 'return_mean'))}",
        f"speed {_number(_mean(actors, 'speed'))} m/s",
        f"collisions {_share(_mean(actors, 'collision_rate'))}",
    ]
    evaluation = snapshot.evaluations.get("policy")
    if evaluation is not None:
        parts.append(f"policy {evaluation.policy_version} scored {_score(evaluation.scores)}")
    parts += [text for text in (snapshot.silence or state.waiting, ", ".join(snapshot.warnings)) if text]
    return "  ".join(parts)


REPLAY = "replay_transitions"
CHANGES_SHOWN = 5  # of the settings, the newest ones


def _progress(snapshot: RunSnapshot) -> RenderableType:
    state = snapshot.state
    if state is None:
        return Text("waiting for the learner's state", style="yellow")
    line = Table.grid(padding=(0, 2))
    share = state.environment_steps / max(state.environment_steps_target, 1)
    line.add_row(
        ProgressBar(total=1.0, completed=min(share, 1.0), width=30),
        f"{state.environment_steps:,} of {state.environment_steps_target:,}",
        f"{_number(snapshot.steps_per_second)}/s",
        f"ETA {_eta(snapshot)}",
        state.phase.name.lower().replace("_", " "),
    )
    return line


def _learner(snapshot: RunSnapshot) -> str:
    state = snapshot.state
    if state is None:
        return "-"
    replay = snapshot.learner_metric(REPLAY)
    capacity = snapshot.settings.replay.capacity
    parts = [
        f"{state.updates:,} updates ({_number(snapshot.learner_metric('updates_per_second'))}/s)",
        f"replay {_number(replay)} of {capacity:,}",
        f"policy {state.policy_version}, lag {_number(snapshot.learner_metric('policy_lag'))}",
    ]
    if state.waiting and not snapshot.silence:
        parts.append(state.waiting)
    return " · ".join(parts)


def _actor(snapshot: RunSnapshot, name: str, values: dict[str, float]) -> str:
    return " · ".join(
        [
            f"{_number(values.get('decisions_per_second'))} decisions/s",
            f"return {_number(values.get('return_mean'))}",
            f"{_number(values.get('speed'))} m/s",
            f"collisions {_share(values.get('collision_rate'))}",
            f"lag {_number(snapshot.learner_metric(f'policy_lag/{name}'))}",
        ]
    )


def _evaluations(snapshot: RunSnapshot) -> Text:
    if not snapshot.of_role("evaluator"):
        return Text("none present", style="yellow")
    result = snapshot.evaluations.get("policy")
    if result is None:
        return Text("no policy scored yet")
    if snapshot.finished:
        others = [f"{driver} {_mean_return(scores)}" for driver, scores in _reference_scores(snapshot)]
        return Text(" · ".join(["closing comparison", f"policy {_mean_return(result.scores)}", *others]))
    return Text(
        f"policy {result.policy_version} of step {result.environment_steps:,}: {_score(result.scores)}"
    )


def _reference_scores(snapshot: RunSnapshot) -> list[tuple[str, dict[str, float]]]:
    """Scores of the drivers that the closing comparison has finished."""
    return [(name, result.scores) for name, result in snapshot.evaluations.items() if name != "policy"]


def _mean_return(scores: dict[str, float]) -> str:
    return f"{_number(scores.get('return_mean'))} ± {_number(scores.get('return_ci95'))}"


def _score(scores: dict[str, float]) -> str:
    """A driver's scores over all towns, and its return in each if there are several."""
    suffix = "/return_mean"
    towns = [f"{name.removesuffix(suffix)} {_number(scores[name])}" for name in scores if suffix in name]
    each = f" ({', '.join(towns)})" if towns else ""
    return (
        f"return {_mean_return(scores)}{each}, "
        f"{_number(scores.get('speed_mps'))} m/s, collisions {_share(scores.get('collision_rate'))}"
    )


def _eta(snapshot: RunSnapshot) -> str:
    state, rate = snapshot.state, snapshot.steps_per_second
    if state is None or not rate or state.phase is Phase.WARMING_UP:  # a faster phase
        return "-"
    seconds = max(state.environment_steps_target - state.environment_steps, 0) / rate
    if not math.isfinite(seconds):
        return "-"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}"


def _mean(services: dict[str, dict[str, float]], name: str) -> float | None:
    values = [metrics[name] for metrics in services.values() if name in metrics]
    return sum(values) / len(values) if values else None


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    digits = 0 if abs(value) >= 100 or value == int(value) else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def _share(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{100 * value:.0f} %"
