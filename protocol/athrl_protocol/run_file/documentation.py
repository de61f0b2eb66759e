"""Documentation of every setting, for the default run file and the reference page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from athrl_protocol.run_file.planner_tables import declared_planners, default_kind
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.toml_values import choice, to_toml_value

_TYPES = {int: "integer", float: "number", str: "text", bool: "true or false"}
END = "# This is the end of the run file; without this line it was cut off."
LAST_SETTING_WITHOUT_END = "network.patience"
"""Which setting was the last one when saved run files did not have `END` yet."""

_BOUNDS = (("ge", ">="), ("gt", ">"), ("le", "<="), ("lt", "<"))


@dataclass(frozen=True)
class Setting:
    """One key of the run file.

    Attributes:
        section: table of the run file.
        key: key within the table.
        default: value if the run file has none.
        expected: type and bounds in words, for instance `integer, >= 1, <= 4096`.
        description: its meaning, with its unit.
    """

    section: str
    key: str
    default: Any
    expected: str
    description: str

    @property
    def name(self) -> str:
        """Dotted name, as `--set` takes it."""
        return f"{self.section}.{self.key}"

    @property
    def comment(self) -> str:
        """Meaning and allowed values, in one line."""
        return f"{self.description} ({self.expected})"


def sections() -> dict[str, type[Section]]:
    """Return the sections of a run file in their order."""
    return {name: type(section) for name, section in RunFile() if isinstance(section, Section)}


def settings(kind: str | None = None) -> Iterator[Setting]:
    """Yield every setting of a run whose planner is of that kind, in the order of the run file.

    None is the default kind. Of a kind that was not declared only the name is known.
    """
    for section_name, section in sections().items():
        if section_name == "planner":
            yield _kind_setting()
            yield from planner_settings(default_kind() if kind is None else kind)
        else:
            for key, field in section.model_fields.items():
                yield _setting(section_name, key, field)


def planner_settings(kind: str) -> Iterator[Setting]:
    """Yield the settings of planners of that kind; none if it was not declared."""
    table = declared_planners().get(kind)
    for key, field in table.model_fields.items() if table is not None else ():
        yield _setting("planner", key, field)


def is_text(name: str) -> bool:
    """Return whether a setting, of any declared kind of planner, is a text."""
    section, _, key = name.partition(".")
    tables = declared_planners().values() if section == "planner" else (sections().get(section),)
    fields = [table.model_fields[key] for table in tables if table is not None and key in table.model_fields]
    return bool(fields) and all(field.annotation is str for field in fields)


def planner_meaning(kind: str) -> str:
    """Return the summary of a declared kind of planner, one line without a full stop; it may be empty."""
    lines = (declared_planners()[kind].__doc__ or "").strip().splitlines()
    return lines[0].strip().rstrip(".") if lines else ""


def _kind_setting() -> Setting:
    kinds = list(declared_planners())
    meanings = ", ".join(f"{kind} ({planner_meaning(kind)})" for kind in kinds if planner_meaning(kind))
    return Setting(
        section="planner",
        key="kind",
        default=default_kind(),
        expected=choice(kinds) if kinds else "text",
        description=f"The kind of planner: {meanings}." if meanings else "The kind of planner.",
    )


def _setting(section: str, key: str, field: FieldInfo) -> Setting:
    default = field.get_default(call_default_factory=True, validated_data={})
    return Setting(section, key, default, _expected(field), field.description or "")


def _number(value: float) -> str:
    if value == 2**63 - 1:
        return "2^63 - 1"
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e12 else f"{value:g}"


def _expected(field: FieldInfo) -> str:
    if isinstance(field.json_schema_extra, dict) and "expected" in field.json_schema_extra:
        return str(field.json_schema_extra["expected"])
    if get_origin(field.annotation) is Literal:
        return choice(get_args(field.annotation))
    words = [name for kind, name in _TYPES.items() if field.annotation is kind]
    for constraint in field.metadata:
        words += [
            f"{sign} {_number(getattr(constraint, name))}"
            for name, sign in _BOUNDS
            if hasattr(constraint, name)
        ]
    return ", ".join(words)


def to_toml(run_file: RunFile) -> str:
    """Return a run file as TOML, every setting under a comment with its meaning, type and bounds.

    Settings of a planner whose kind was not declared have no comment.
    """
    lines = [
        "# A run of athrl. Every setting may be left out and then has the value that is given here;",
        "# on the command line: --set learner.batch=64",
    ]
    comments = {setting.name: setting.comment for setting in settings(run_file.planner.kind)}
    values = run_file.model_dump()
    for section_name, section in sections().items():
        lines += ["", f"# {(section.__doc__ or '').strip()}", f"[{section_name}]"]
        for key, value in values[section_name].items():
            if f"{section_name}.{key}" in comments:
                lines.append(f"# {comments[f'{section_name}.{key}']}")
            lines.append(f"{key} = {to_toml_value(value)}")
    return "\n".join(lines) + "\n"


def saved_toml(run_file: RunFile) -> str:
    """Return the run file as it is kept in the run's folder: as TOML, with an end that shows it whole."""
    return f"{to_toml(run_file)}\n{END}\n"


def ends_whole(text: str) -> bool:
    """Return whether a saved run file is whole."""
    return text.rstrip().endswith(END)


def default_toml(kind: str | None = None) -> str:
    """Return the documented default run file, for a planner of that kind or of the default one."""
    return to_toml(RunFile.model_validate({} if kind is None else {"planner": {"kind": kind}}))
