"""The section `[planner]`: a kind, and the settings of planners of that kind.

The protocol knows no planner. The program that starts a run declares the settings of each kind, and the
section is checked against them: unknown kinds and keys and wrong values are refused, missing settings have
their defaults. A process without declared planners, such as an actor, takes the section unchecked: the
learner, which serves it, has checked it.
"""

from __future__ import annotations

import difflib
import re
import weakref
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.toml_values import choice

DEFAULT_KIND = "athrl"
"""The kind of planner of a run that names none, in a process without declared kinds."""

_KIND = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")

_declared: dict[str, type[BaseModel]] = {}

_ready: weakref.WeakSet[type[BaseModel]] = weakref.WeakSet()
"""The tables that have got their checks; declared again, they need no others."""


def declare_planners(tables: Mapping[str, type[BaseModel]]) -> None:
    """Declare the kinds of planner; replaces earlier declarations.

    Args:
        tables: the settings of each kind, in the order of the documentation; the first kind is the default.
            The first line of a table's docstring is the summary of the planner. A table gets the checks of
            every section: strict types, finite numbers, no unknown keys. Every setting needs a default that
            TOML can write.

    Raises:
        ValueError: a kind or a table is not valid; says why.
    """
    checked = {kind: _checked(kind, table) for kind, table in tables.items()}
    _declared.clear()
    _declared.update(checked)


def declared_planners() -> Mapping[str, type[BaseModel]]:
    """The settings of each declared kind."""
    return dict(_declared)


def default_kind() -> str:
    """The kind of planner of a run file that names none."""
    return next(iter(_declared), DEFAULT_KIND)


def kind_error(kind: Any) -> str | None:
    """What a kind of planner should be, with the nearest name; None if the kind is valid."""
    if not isinstance(kind, str) or (not _declared and _KIND.fullmatch(kind) is None):
        return f"should be {_expected_kind()}"
    if _declared and kind not in _declared:
        near = difflib.get_close_matches(kind.lower(), _declared, n=1, cutoff=0.4)
        return f"should be {_expected_kind()}" + (f"; did you mean {near[0]}?" if near else "")
    return None


def kinds_with(key: str) -> list[str]:
    """The kinds of planner that have a setting `key`."""
    return [kind for kind, table in _declared.items() if key in table.model_fields]


def without_defaults_of_other_kinds(table: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """A table `[planner]` without settings that `kind` lacks, if they have the default of the table's own
    kind.

    So a run file with every setting of one kind can also be used for another kind. A setting that differs
    from its default stays and will be refused: its author wants something that `kind` does not have.
    """
    own, other = _declared.get(table.get("kind", default_kind())), _declared.get(kind)
    if own is None or other is None:
        return dict(table)
    return {
        key: value
        for key, value in table.items()
        if key == "kind" or key in other.model_fields or not _is_default(own, key, value)
    }


def _is_default(table: type[BaseModel], key: str, value: Any) -> bool:
    field = table.model_fields.get(key)
    if field is None:
        return False
    default = field.get_default(call_default_factory=True, validated_data={})
    return bool(value == default) and isinstance(value, bool) == isinstance(default, bool)


def _expected_kind() -> str:
    return choice(_declared) if _declared else "the name of a planner"


def _checked(kind: str, table: type[BaseModel]) -> type[BaseModel]:
    """The table, with the checks of every section."""
    if _KIND.fullmatch(kind) is None:
        raise ValueError(f"a kind of planner is {kind!r}: should be letters, digits, '.', '_' and '-'")
    if table in _ready:
        return table
    for key, field in table.model_fields.items():
        if key == "kind":
            raise ValueError(f"the planner {kind} has a setting 'kind', which names the planner itself")
        if field.is_required():
            raise ValueError(f"the planner {kind} has no default for its setting {key!r}: give it one")
    body = {"__doc__": table.__doc__, "__module__": table.__module__, "model_config": Section.model_config}
    held = type(table.__name__, (table,), body)
    for key, value in held().model_dump().items():
        if not isinstance(value, bool | int | float | str | list):
            raise ValueError(f"the planner {kind} has {key} = {value!r:.60}, for which TOML has no value")
    _ready.add(held)
    return held


class PlannerSection(Section):
    """The planner and how it learns."""

    model_config = ConfigDict(extra="allow")

    kind: str = Field(default_factory=default_kind, description="The kind of planner.")

    @model_validator(mode="before")
    @classmethod
    def _check_against_declared(cls, section: Any) -> Any:
        if not isinstance(section, Mapping):
            return section
        kind = section.get("kind", default_kind())
        wrong = kind_error(kind)
        if wrong is not None:
            raise ValueError(f"planner.kind = {kind!r:.60}: {wrong}")
        given = {key: value for key, value in section.items() if key != "kind"}
        if kind in _declared:
            given = _declared[kind].model_validate(given).model_dump()
        return {"kind": kind, **given}

    def values(self) -> dict[str, Any]:
        """The settings of this kind of planner by name, without its kind."""
        return dict(self.model_extra or {})
