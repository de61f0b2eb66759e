"""Read a run file and overrides from the command line; what is wrong becomes one line that names it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.documentation import Setting, settings
from athrl_protocol.run_file.names import KnownNames, one_line, show
from athrl_protocol.run_file.planner_tables import (
    default_kind,
    left_out_for_another_kind,
    what_is_wrong_with_kind,
)
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.toml_values import to_toml_value


@dataclass(frozen=True)
class _Override:
    """A setting from the command line: its name, its value, and how it was written, in one line."""

    name: str
    value: Any
    text: str

    @property
    def place(self) -> str:
        return f"--set {self.text}"


def read_run_file(
    path: str | Path | None,
    overrides: Sequence[str] = (),
    *,
    complete: bool = False,
    training: bool = True,
) -> RunFile:
    """Read and validate a run file.

    Args:
        path: a TOML file; None for the defaults.
        overrides: `section.key=value` with a TOML value; text needs no quotes. The last one counts. With
            another `planner.kind` the file's settings that this kind lacks are left out where they have
            their default.
        complete: whether every setting has to be there, as in the file that a run was started with.
        training: whether somebody is to train by it. For driving alone settings of training need not fit
            each other: episodes, for instance, may be shorter than a sequence.

    Raises:
        RunFileError: one line with the file or override, the key, its value and what it should be.
    """
    source = str(path) if path is not None else "run file"
    values = _read_toml(Path(path)) if path is not None else {}
    if complete:
        _require_every_setting(values, source)
    parsed = [_parse_override(override) for override in overrides]
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
    """Return the kind of planner: which other names there are depends on it."""
    table = values.get("planner")
    if not isinstance(table, dict) or "kind" not in table:
        return default_kind()
    kind = table["kind"]
    wrong = what_is_wrong_with_kind(kind)
    if wrong is not None:
        override = overridden.get("planner.kind")
        place = override.place if override else f"{source}: planner.kind = {show(kind)}"
        raise RunFileError(f"{place}: {wrong}")
    return str(kind)


def _require_every_setting(values: dict[str, Any], source: str) -> None:
    """A file that was cut off is still TOML; with defaults for what it lost it would be another run."""
    for setting in settings(_planner_kind(values, source, {})):
        table = values.get(setting.section)
        if not isinstance(table, dict) or setting.key not in table:
            raise RunFileError(
                f"{source}: {setting.name} is missing, the file is damaged or of another release: "
                "put back what the run began with"
            )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise RunFileError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise RunFileError(f"{path}: is not a TOML file, which is UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise RunFileError(f"{path}: is not TOML: {one_line(str(error))}") from None


def _parse_override(text: str) -> _Override:
    name, equals, value = text.partition("=")
    name, text = name.strip(), one_line(text)
    section, _, key = name.partition(".")
    if not equals or not name:
        raise RunFileError(f"--set {text}: should look like section.key=value, for instance learner.batch=64")
    if not section or not key:
        KnownNames(default_kind()).check_setting(name, f"--set {text}")
    return _Override(name, _parse_value(value.strip()), text)


def _parse_value(text: str) -> Any:
    """Return the TOML value that is written in `text`; what is none is text itself."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text


def _set(values: dict[str, Any], override: _Override) -> None:
    section, _, key = override.name.partition(".")
    table = values.setdefault(section, {})
    if not isinstance(table, dict):
        raise RunFileError(f"{override.place}: the run file has {section} = {show(table)}: should be a table")
    table[key] = override.value


def _leave_out_for_another_kind(values: dict[str, Any], overrides: Sequence[_Override]) -> None:
    """Take out of the file what the overrides' kind of planner lacks and nobody has asked for."""
    table = values.get("planner")
    kinds = [override.value for override in overrides if override.name == "planner.kind"]
    if isinstance(table, dict) and kinds and isinstance(kinds[-1], str):
        values["planner"] = left_out_for_another_kind(table, kinds[-1])


def _describe(error: ValidationError, kind: str, source: str, overridden: Mapping[str, _Override]) -> str:
    details = error.errors(include_url=False)
    first = details[0]
    name = ".".join(str(part) for part in first["loc"][:2])
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    setting = next((setting for setting in settings(kind) if setting.name == name), None)
    if setting is None:  # a check between settings, whose text names them
        return f"{source}: {_own_words(first)}{more}"
    place = overridden[name].place if name in overridden else f"{source}: {name} = {show(first['input'])}"
    return f"{place}: {_expectation(setting, first)}{more}"


def _expectation(setting: Setting, detail: ErrorDetails) -> str:
    if detail["type"] in ("value_error", "assertion_error"):
        return _own_words(detail)
    if detail["type"] == "string_pattern_mismatch":
        return f"should be text like {to_toml_value(setting.default)} ({setting.description})"
    return f"should be {setting.expected} ({setting.description})"


def _own_words(detail: ErrorDetails) -> str:
    """The text that a check itself has given."""
    return one_line(re.sub(r"^(Value|Assertion) error, ", "", detail["msg"]))
