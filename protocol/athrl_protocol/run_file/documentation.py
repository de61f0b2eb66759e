"""Every setting with its meaning, as the default run file and as entries for a reference page."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.sections import Section

_TYPES = {int: "integer", float: "number", str: "text", bool: "true or false"}
_BOUNDS = (("ge", ">="), ("gt", ">"), ("le", "<="), ("lt", "<"))


@dataclass(frozen=True)
class Setting:
    """One key of the run file.

    Attributes:
        section: table of the run file.
        key: key within the table.
        default: value when the run file does not give one.
        expected: type and bounds in words, for instance `integer, >= 1, <= 4096`.
        description: what it means, with its unit.
    """

    section: str
    key: str
    default: int | float | str | bool
    expected: str
    description: str

    @property
    def name(self) -> str:
        """Dotted name, as `--set` takes it."""
        return f"{self.section}.{self.key}"


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _expected(field: FieldInfo) -> str:
    if get_origin(field.annotation) is Literal:
        choices = [to_toml_value(choice) for choice in get_args(field.annotation)]
        return choices[0] if len(choices) == 1 else f"{', '.join(choices[:-1])} or {choices[-1]}"
    words = [name for kind, name in _TYPES.items() if field.annotation is kind]
    for constraint in field.metadata:
        words += [
            f"{sign} {_number(getattr(constraint, name))}"
            for name, sign in _BOUNDS
            if hasattr(constraint, name)
        ]
    return ", ".join(words)


def sections() -> dict[str, type[Section]]:
    """Return the sections of a run file in their order."""
    return {name: type(section) for name, section in RunFile() if isinstance(section, Section)}


def settings() -> Iterator[Setting]:
    """Yield every setting in the order of the run file."""
    for section_name, section in sections().items():
        for key, field in section.model_fields.items():
            yield Setting(section_name, key, field.default, _expected(field), field.description or "")


def to_toml_value(value: Any) -> str:
    """Return a number, text or truth value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def to_toml(run_file: RunFile) -> str:
    """Return a run file as TOML, every setting under a comment with its meaning, type and bounds."""
    lines = [
        "# A run of athrl. Every setting may be left out and then has the value that is given here;",
        "# on the command line: --set learner.batch=64",
    ]
    values = run_file.model_dump()
    for section_name, section in sections().items():
        lines += ["", f"# {(section.__doc__ or '').strip()}", f"[{section_name}]"]
        for setting in settings():
            if setting.section == section_name:
                lines.append(f"# {setting.description} ({setting.expected})")
                lines.append(f"{setting.key} = {to_toml_value(values[section_name][setting.key])}")
    return "\n".join(lines) + "\n"


def default_toml() -> str:
    """Return the documented default run file."""
    return to_toml(RunFile())
