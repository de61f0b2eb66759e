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
from rich.console import Console
from rich.live import Live

from athrl.errors import CommandError
from athrl.names import host_name, is_own_name
from athrl.options import DEFAULTS, CertificatesOption, ConnectOption, JsonOption, LiveRunOption
from athrl.picture import draw
from athrl.run_view import RunSnapshot, RunView
from athrl.single_role import warn_who_sees_little
from athrl.stopping import stop_on_signal

ANSWER_SECONDS = 5.0
"""How long the learner may take to be reached."""

ROLES = ("learner", "actor", "evaluator", "router")
"""Who takes part in a run under a name."""

METRICS_SECONDS = 1.5
"""Services speak once a second: after so long everybody was heard."""


def status(
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    as_json: JsonOption = False,
    follow: Annotated[bool, typer.Option("--follow", help="Keep showing the run until Ctrl-C.")] = False,
    check: Annotated[
        str | None,
        typer.Option(
            metavar="ROLE[/NAME]",
            help="Exit code 0 says that such a service takes part; an actor or router without NAME is one "
            "that has this host's name, with or without a process's number.",
        ),
    ] = None,
    certificates: CertificatesOption = None,
) -> None:
    """Show how a live run is."""
    if check is not None:
        _check(connect, run, check)
        return
    warn_who_sees_little(certificates)
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
    """Return what is known once every service has had time to speak.

    So short a look measures no rate of its own; the learner's is of its last second.
    """
    time.sleep(METRICS_SECONDS)
    snapshot = view.snapshot()
    if snapshot.steps_per_second is not None:
        return snapshot
    return replace(snapshot, steps_per_second=snapshot.learner_metric("environment_steps_per_second"))


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
    if role not in ROLES:
        raise CommandError(f"--check {who}: there is no role {role!r}, it should be {', '.join(ROLES)}")
    belongs, called = _meant(role, name)
    with ExitStack() as stack:
        session = stack.enter_context(open_session(connect=connect, timeout=ANSWER_SECONDS))
        run = fetch_run_file(session, run, timeout=ANSWER_SECONDS).run.name
        presence = stack.enter_context(PresenceWatcher(session, run))
        state = stack.enter_context(StateSubscriber(session, run))
        present = presence.wait_for(
            lambda there: any(kind == role and belongs(name) for kind, name in there), ANSWER_SECONDS
        )
        if not present or (role == "learner" and state.wait(ANSWER_SECONDS) is None):
            raise CommandError(f"no {role} {called} takes part in the run {run}")


def _meant(role: str, name: str) -> tuple[Callable[[str], bool], str]:
    """Return which services' names are meant, and in words; without a name those that `names` gives."""
    if name or role in ("learner", "evaluator"):
        wanted = name or role
        return lambda other: other == wanted, repr(wanted)
    return is_own_name, f"of this host ({host_name()!r}, or with a process's number behind it)"


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
