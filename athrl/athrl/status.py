"""`athrl status`: a live run in a terminal, as JSON, or as a yes or no."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from typing import Annotated, Any

import typer
from athrl_protocol import PresenceWatcher, StateSubscriber, fetch_run_file, open_session
from athrl_protocol.messages.keys import HOST_ROLE
from rich.console import Console
from rich.live import Live

from athrl.certificate_role import warn_limited_view
from athrl.errors import CommandError
from athrl.options import DEFAULTS, CertificatesOption, ConnectOption, JsonOption, LiveRunOption
from athrl.output import of_json
from athrl.run_view import RunSnapshot, RunView
from athrl.service_names import host_name, is_own_name
from athrl.status_panel import draw
from athrl.stopping import stop_on_signal

ANSWER_SECONDS = 5.0
"""Limit for the connection to the learner."""

ROLES = ("learner", "actor", "evaluator", "router")
"""Roles with named services in a run."""

METRICS_SECONDS = 1.5
"""Services report once a second: after so long all have reported."""


def status(
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    as_json: JsonOption = False,
    follow: Annotated[bool, typer.Option("--follow", help="Update the view until Ctrl-C.")] = False,
    check: Annotated[
        str | None,
        typer.Option(
            metavar="ROLE[/NAME]",
            help="Only check that such a service is present (exit code 0); without NAME an actor or router "
            "of this host.",
        ),
    ] = None,
    certificates: CertificatesOption = None,
) -> None:
    """Show the state of a live run."""
    if check is not None:
        _check(connect, run, check)
        return
    warn_limited_view(certificates)
    with RunView(connect, run, timeout=ANSWER_SECONDS) as view:
        if follow:
            _follow(view)
        else:
            snapshot = _snapshot(view)
            if as_json:
                print(json.dumps(facts(snapshot)))
            else:
                Console().print(draw(snapshot, []))


def _snapshot(view: RunView) -> RunSnapshot:
    """Return the state once every service has had time to report.

    This is too short to measure a rate; the learner's own rate of its last minute is used.
    """
    time.sleep(METRICS_SECONDS)
    snapshot = view.snapshot()
    if snapshot.steps_per_second is not None:
        return snapshot
    return replace(snapshot, steps_per_second=snapshot.learner_metric("environment_steps_per_second"))


def _follow(view: RunView) -> None:
    """Show the run until a signal arrives."""
    with stop_on_signal() as stop, Live(auto_refresh=False) as live:
        while not stop.wait(0.5):
            live.update(draw(view.snapshot(), []), refresh=True)


def _check(connect: str, run: str | None, who: str) -> None:
    """Raise `CommandError` unless the service is present; the learner must also report the run's state.

    Only uses what every role may read, so that a container can check its service with its certificate.
    """
    role, _, name = who.partition("/")
    if role not in ROLES:
        raise CommandError(f"--check {who}: there is no role {role!r}, it should be {', '.join(ROLES)}")
    belongs, called = _meant(role, name)
    # An actor has its name from the learner, and a second token with that of its host.
    shown_as = HOST_ROLE if (role, name) == ("actor", "") else role
    with ExitStack() as stack:
        session = stack.enter_context(open_session(connect=connect, timeout=ANSWER_SECONDS))
        run = fetch_run_file(session, run, timeout=ANSWER_SECONDS).run.name
        presence = stack.enter_context(PresenceWatcher(session, run))
        state = stack.enter_context(StateSubscriber(session, run))
        present = presence.wait_for(
            lambda there: any(kind == shown_as and belongs(name) for kind, name in there), ANSWER_SECONDS
        )
        if not present or (role == "learner" and state.wait(ANSWER_SECONDS) is None):
            raise CommandError(f"no {role} {called} takes part in the run {run}")


def _meant(role: str, name: str) -> tuple[Callable[[str], bool], str]:
    """Return a condition on names, and its description; without a name the default names of this host."""
    if name or role in ("learner", "evaluator"):
        wanted = name or role
        return lambda other: other == wanted, repr(wanted)
    return is_own_name, f"of this host ({host_name()!r}, or with a process number)"


def facts(snapshot: RunSnapshot) -> dict[str, Any]:
    """Return a run's state as plain values: one object, the services' metrics by name."""
    state = snapshot.state
    return {
        "run": snapshot.settings.run.name,
        "phase": state.phase.name.lower() if state else None,
        "environment_steps": state.environment_steps if state else 0,
        "environment_steps_target": state.environment_steps_target if state else 0,
        "updates": state.updates if state else 0,
        "policy_version": state.policy_version if state else 0,
        "waiting": state.waiting if state else "",
        "silence": snapshot.silence,
        "changes": list(snapshot.changes),
        "warnings": list(snapshot.warnings),
        "learner": of_json(snapshot.of_role("learner").get("learner", {})),
        "actors": of_json(snapshot.of_role("actor")),
        "evaluators": of_json(snapshot.of_role("evaluator")),
        "routers": sorted(snapshot.of_role("router")),
        "evaluations": {driver: of_json(asdict(result)) for driver, result in snapshot.evaluations.items()},
    }
