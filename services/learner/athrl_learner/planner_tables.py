"""The planners' settings, against which the section `[planner]` of a run file is checked first."""

from __future__ import annotations

from athrl_planners import settings_tables
from athrl_planners.registry import UnknownPlanner
from athrl_protocol import RunFile
from athrl_protocol.run_file import PlannerSection, declare_planners
from pydantic import ValidationError

from athrl_learner.errors import WrongPlanner


def declare_installed_planners() -> None:
    """Declare the settings of every installed planner; may be called again.

    Raises:
        WrongPlanner: an installed package names a planner that cannot be loaded.
    """
    try:
        declare_planners(settings_tables())
    except (UnknownPlanner, ValueError) as error:
        raise WrongPlanner(str(error)) from None


def with_planner_settings(run_file: RunFile) -> RunFile:
    """The run file with every setting of its planner, even if it was read without known planners.

    Raises:
        WrongPlanner: there is no such planner, or it has no such setting, or a value is not valid.
    """
    declare_installed_planners()
    values = {"kind": run_file.planner.kind, **run_file.planner.values()}
    try:
        return run_file.model_copy(update={"planner": PlannerSection.model_validate(values)})
    except ValidationError as error:
        raise WrongPlanner(_one_line(error)) from None


def _one_line(error: ValidationError) -> str:
    """The first error, with the name of its setting."""
    first = error.errors(include_url=False)[0]
    said = first["msg"].removeprefix("Value error, ")
    if not first["loc"]:
        return said
    name = ".".join(["planner", *map(str, first["loc"])])
    return f"{name} = {first['input']!r:.60}: {said[:1].lower()}{said[1:]}"
