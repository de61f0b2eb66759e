"""`athrl status`: a live run in a terminal, as JSON, or as a yes or no."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from dataclasses import asdict
from typing import Annotated, Any

import typer
from athrl_protocol import PresenceWatcher, StateSubscriber, fetch_run_file, open_session
from rich.console import Console
from rich.live import Live

from athrl.errors import CommandError
from athrl.names import host_name
from athrl.options import DEFAULTS, CertificatesOption, ConnectOption, JsonOption, LiveRunOption
from athrl.picture import draw
from athrl.run_view import RunSnapshot, RunView
from athrl.stopping import stop_on_signal

ANSWER_SECONDS = 5.0
"""How long the learner may take to be reached."""

METRICS_SECONDS = 1.5
"""Services speak once a second: after so long everybody was heard."""


def status(
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    as_json: JsonOption = False,
    follow: Annotated[bool, typer.Option("--follow", help="Go on showing the run until Ctrl-C.")] = False,
    check: Annotated[
        str | None,
        typer.Option(
            metavar="ROLE[/NAME]",
            help="Exit code 0 says that such a service takes part; an actor has this host's name.",
        ),
    ] = None,
    certificates: CertificatesOption = None,
) -> None:
    """Show how a live run is."""
    if check is not None:
        _check(connect, run, check)
        return
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
    """Return what is known once every service has had time to speak."""
    time.sleep(METRICS_SECONDS)
    return view.snapshot()


def _follow(view: RunView) -> None:
    """Show the run until a signal comes."""
    with stop_on_signal() as stop, Live(auto_refresh=False) as live:
        while not stop.wait(0.5):
            live.update(draw(view.snapshot(), []), refresh=True)


def _check(connect: str, run: str | None, who: str) -> None:
    """Raise `CommandError` unless the service is there; the learner has to tell the run's state, too.

    Asks for no more than every role may know, so that a service's container can look with its certificate.
    """
    role, _, name = who.partition("/")
    name = name or (host_name() if role == "actor" else role)
    with ExitStack() as stack:
        session = stack.enter_context(open_session(connect=connect, timeout=ANSWER_SECONDS))
        run = fetch_run_file(session, run, timeout=ANSWER_SECONDS).run.name
        presence = stack.enter_context(PresenceWatcher(session, run))
        state = stack.enter_context(StateSubscriber(session, run))
        present = presence.wait_for(lambda there: (role, name) in there, ANSWER_SECONDS)
        if not present or (role == "learner" and state.wait(ANSWER_SECONDS) is None):
            raise CommandError(f"no {role} {name!r} takes part in the run {run}")


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
        "learner": snapshot.of_role("learner").get("learner", {}),
        "actors": snapshot.of_role("actor"),
        "evaluators": snapshot.of_role("evaluator"),
        "evaluations": {driver: asdict(result) for driver, result in snapshot.evaluations.items()},
    }
