"""Read a run file and overrides from the command line; an error is one line that names the setting."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import one_line, one_short_line
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.document import NoToml, check_value, parse_document, read_document
from athrl_protocol.run_file.documentation import (
    LAST_SETTING_WITHOUT_END,
    Setting,
    ends_whole,
    is_text,
    settings,
)
from athrl_protocol.run_file.names import KnownNames
from athrl_protocol.run_file.planner_tables import (
    default_kind,
    kind_error,
    without_defaults_of_other_kinds,
)
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.toml_values import show, to_toml_value


@dataclass(frozen=True)
class _Override:
    """A setting that overrides one of the file: its name and its value."""

    name: str
    value: Any
    place: str
    """Where it was given, for a message."""


class OverrideFrom(str):
    """An override that errors name by the place where it was given, instead of `--set`."""

    def __new__(cls, text: str, origin: str) -> OverrideFrom:
        """Keep the text with its place."""
        found = super().__new__(cls, text)
        found.origin = origin
        return found

    origin: str


def read_run_file(
    path: str | Path | None,
    overrides: Sequence[str] = (),
    *,
    complete: bool = False,
    training: bool = True,
    changes: str | Path | None = None,
) -> RunFile:
    """Read and validate a run file.

    Args:
        path: a TOML file; None for the defaults.
        overrides: `section.key=value` with a TOML value; text needs no quotes. The last one counts. With
            another `planner.kind`, settings of the file that this kind lacks are dropped if they have their
            default.
        complete: whether it must be a whole file that a run was saved with. Settings that are newer than the
            release that saved it have their defaults.
        training: whether the run file is for training. For driving alone the settings of training need not
            fit each other: episodes, for instance, may be shorter than a sequence.
        changes: another TOML file, whose settings override those of `path`; `overrides` override both.

    Raises:
        RunFileError: one line with the file or override, the key, its value and the allowed values.
    """
    source = str(path) if path is not None else "run file"
    values = read_document(Path(path)) if path is not None else {}
    if complete:
        _require_whole(Path(source), values)
    parsed = [*_given_in(changes), *(_parse_override(override) for override in overrides)]
    _leave_out_for_another_kind(values, parsed)
    for override in parsed:
        _set(values, override)
    overridden = {override.name: override for override in parsed}
    kind = _planner_kind(values, source, overridden)
    names = KnownNames(kind)
    for override in parsed:
        names.check_setting(override.name, override.place)
    names.check_tables(values, source)
    try:
        return RunFile.model_validate(values, context={"training": training})
    except ValidationError as error:
        raise RunFileError(_describe(error, kind, source, overridden)) from None


def _planner_kind(values: dict[str, Any], source: str, overridden: Mapping[str, _Override]) -> str:
    """Return the kind of planner, on which the other valid names depend."""
    table = values.get("planner")
    if not isinstance(table, dict) or "kind" not in table:
        return default_kind()
    kind = table["kind"]
    wrong = kind_error(kind)
    if wrong is not None:
        override = overridden.get("planner.kind")
        place = override.place if override else f"{source}: planner.kind = {show(kind)}"
        raise RunFileError(f"{place}: {wrong}")
    return str(kind)


def _given_in(path: str | Path | None) -> list[_Override]:
    """The settings of a file, as overrides of another one."""
    if path is None:
        return []
    values = read_document(Path(path))
    for section, table in values.items():
        if not isinstance(table, dict):  # for which this raises
            KnownNames(default_kind()).check_tables({section: table}, str(path))
    return [
        _Override(f"{section}.{key}", value, f"{path}: {section}.{key} = {show(value)}")
        for section, table in values.items()
        for key, value in table.items()
    ]


def _require_whole(path: Path, values: dict[str, Any]) -> None:
    """Refuse a truncated file: it may still be TOML, and with defaults it would be another run.

    A whole one ends with a line that says so. Files of earlier releases do not, but had every setting.
    """
    if ends_whole(path.read_text(encoding="utf-8")):
        return
    section, _, key = LAST_SETTING_WITHOUT_END.partition(".")
    table = values.get(section)
    if not isinstance(table, dict) or key not in table:
        _require_every_setting(values, str(path))


def _require_every_setting(values: dict[str, Any], source: str) -> None:
    for setting in settings(_planner_kind(values, source, {})):
        table = values.get(setting.section)
        if not isinstance(table, dict) or setting.key not in table:
            raise RunFileError(
                f"{source}: {setting.name} is missing, the file is damaged or of another release: "
                "restore the file that the run was started with"
            )


def _parse_override(text: str) -> _Override:
    name, equals, value = text.partition("=")
    origin = text.origin if isinstance(text, OverrideFrom) else "--set"
    name, place = name.strip(), f"{origin} {one_short_line(text)}"
    section, _, key = name.partition(".")
    if not equals or not name:
        quotes = "; quotes hold a value with a space together" if origin != "--set" else ""
        raise RunFileError(
            f"{place}: should look like section.key=value, for instance learner.batch=64{quotes}"
        )
    if not section or not key:
        KnownNames(default_kind()).check_setting(name, place)
    return _Override(name, _parse_value(name, value.strip(), place), place)


def _parse_value(name: str, text: str, place: str) -> Any:
    """Return the TOML value in `text`; if it is no TOML, or the setting is a text, the text itself.

    So a run may be called 2024 or true; quotes of TOML are taken off.
    """
    value = _parse_toml_value(text, place)
    value = text if is_text(name) and not isinstance(value, str) else value
    check_value(value, place)
    return value


def _parse_toml_value(text: str, place: str) -> Any:
    try:
        parsed = parse_document(f"value = {text}", place)
    except NoToml:
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text


def _set(values: dict[str, Any], override: _Override) -> None:
    section, _, key = override.name.partition(".")
    table = values.setdefault(section, {})
    if not isinstance(table, dict):
        raise RunFileError(f"{override.place}: the run file has {section} = {show(table)}: should be a table")
    table[key] = override.value


def _leave_out_for_another_kind(values: dict[str, Any], overrides: Sequence[_Override]) -> None:
    """Remove settings from the file that the overrides' kind of planner lacks, if they have defaults."""
    table = values.get("planner")
    kinds = [override.value for override in overrides if override.name == "planner.kind"]
    if isinstance(table, dict) and kinds and isinstance(kinds[-1], str):
        values["planner"] = without_defaults_of_other_kinds(table, kinds[-1])


def _describe(error: ValidationError, kind: str, source: str, overridden: Mapping[str, _Override]) -> str:
    details = error.errors(include_url=False)
    first = details[0]
    name = ".".join(str(part) for part in first["loc"][:2])
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    setting = next((setting for setting in settings(kind) if setting.name == name), None)
    if setting is None:  # a check of several settings, whose text names them
        return f"{source}: {_own_words(first)}{more}"
    place = overridden[name].place if name in overridden else f"{source}: {name} = {show(first['input'])}"
    return f"{place}: {_expectation(setting, first)}{more}"


def _expectation(setting: Setting, detail: ErrorDetails) -> str:
    if detail["type"] in ("value_error", "assertion_error"):
        return _own_words(detail)
    if detail["type"] == "string_pattern_mismatch" and setting.expected == "text":
        return f"should be text like {to_toml_value(setting.default)} ({setting.description})"
    quoted = ", in quotes" if detail["type"] == "string_type" else ""
    return f"should be {setting.expected}{quoted} ({setting.description})"


def _own_words(detail: ErrorDetails) -> str:
    """The text of a check's own error."""
    return one_line(re.sub(r"^(Value|Assertion) error, ", "", detail["msg"]))
