"""`athrl replay`: drive a recorded episode again and tell whether it is the same."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from athrl_spaces.untrusted import one_line
from athrl_spaces.wording import system_reason

from athrl.errors import CommandError, needs
from athrl.evaluate.places import check_town
from athrl.options import JsonOption
from athrl.output import of_json

if TYPE_CHECKING:
    from athrl_evaluator.replay import Difference, Verdict

DIFFERENT = 1
"""Exit code where the states are not the same."""


def replay(
    recording: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="A recorded episode.")],
    town: Annotated[
        str | None, typer.Option(help="Where the episode's map is now, if it is not where it was.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Drive a recorded episode again from its seed and actions, and compare every state.

    Bit for bit where the same kernels run on the same processor, else within 1e-6. The exit code is 0 if the
    states are the same, 1 if they are not, 2 if the recording cannot be driven again.
    """
    if town is not None:
        check_town(town)
    with needs("evaluator"):
        from athrl_evaluator.replay import replay as drive_again
    verdict = drive_again(recording, town)
    told = json.dumps({"file": str(recording), **_facts(verdict)})
    try:
        print(told if as_json else one_line(f"{recording}: {_text(verdict)}"), flush=True)
    except OSError as error:  # as code 1 it would say that the states differ
        raise CommandError(f"cannot write the verdict: {system_reason(error)}") from None
    if not verdict.same:
        raise typer.Exit(DIFFERENT)


def _facts(verdict: Verdict) -> dict[str, object]:
    """The verdict as values of JSON."""

    def plain(difference: Difference | None) -> dict[str, object] | None:
        return None if difference is None else of_json({**asdict(difference), "size": difference.size})

    facts = {**vars(verdict), "first": plain(verdict.first), "largest": plain(verdict.largest)}
    return {"same": verdict.same, **facts}


def _text(verdict: Verdict) -> str:
    """The verdict in one line."""
    driver = f"{verdict.driver} {verdict.policy}".strip()
    episode = f"{verdict.decisions} decisions ({verdict.seconds:.1f} s) of {driver}"
    episode += f" in {verdict.town}, seed {verdict.seed}"
    elsewhere = f"; recorded by {verdict.recorded_by}" if verdict.recorded_by else ""
    if verdict.first is not None:
        first, largest = verdict.first, verdict.largest or verdict.first
        return (
            f"different from decision {first.decision} on ({first.time:.1f} s): {first.number} was "
            f"{first.recorded!r}, is {first.replayed!r}; the largest difference is {largest.size:.3g} "
            f"({largest.number}, decision {largest.decision}); {episode}{elsewhere}"
        )
    if not verdict.recorded_by:
        return f"the same, bit for bit: {episode}"
    size = 0.0 if verdict.largest is None else verdict.largest.size
    return f"the same within 1e-6 (largest difference {size:.2g}): {episode}{elsewhere}"
