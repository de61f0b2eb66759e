"""Read a run file and overrides from the command line; what is wrong becomes one line that names it."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.documentation import sections, settings, to_toml_value
from athrl_protocol.run_file.root import RunFile


def read_run_file(
    path: str | Path | None, overrides: Sequence[str] = (), *, complete: bool = False
) -> RunFile:
    """Read and validate a run file.

    Args:
        path: a TOML file; None for the defaults.
        overrides: `section.key=value` with a TOML value; text needs no quotes. The last one counts.
        complete: whether every setting has to be there, as in the file that a run was started with.

    Raises:
        RunFileError: one line with the file or override, the key, its value and what it should be.
    """
    values = _read_toml(Path(path)) if path is not None else {}
    if complete:
        _require_every_setting(values, str(path))
    overridden: dict[str, str] = {}
    for override in overrides:
        name, value = _parse_override(override)
        _set(values, name, value, override)
        overridden[name] = _one_line(override)
    source = str(path) if path is not None else "run file"
    _check_names(values, source)
    try:
        return RunFile.model_validate(values)
    except ValidationError as error:
        raise RunFileError(_describe(error, source, overridden)) from None


def _require_every_setting(values: dict[str, Any], source: str) -> None:
    """A file that was cut off is still TOML; with defaults for what it lost it would be another run."""
    for setting in settings():
        table = values.get(setting.section)
        if not isinstance(table, dict) or setting.key not in table:
            raise RunFileError(
                f"{source}: {setting.name} is missing, the file is damaged: put back what the run began with"
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
        raise RunFileError(f"{path}: is not TOML: {_one_line(str(error))}") from None


def _parse_override(override: str) -> tuple[str, Any]:
    name, equals, text = override.partition("=")
    name, override = name.strip(), _one_line(override)
    if not equals or not name:
        raise RunFileError(
            f"--set {override}: should look like section.key=value, for instance learner.batch=64"
        )
    known = {setting.name for setting in settings()}
    if name not in known:
        raise RunFileError(f"--set {override}: {name} is no setting{_suggestion(name, known)}")
    return name, _parse_value(text.strip())


def _parse_value(text: str) -> Any:
    """Return the TOML value that is written in `text`; what is none is text itself."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text


def _set(values: dict[str, Any], name: str, value: Any, override: str) -> None:
    section, _, key = name.partition(".")
    table = values.setdefault(section, {})
    if not isinstance(table, dict):
        raise RunFileError(
            f"--set {override}: the run file has {section} = {_show(table)}: should be a table"
        )
    table[key] = value


def _check_names(values: dict[str, Any], source: str) -> None:
    known_sections = sections()
    known = {setting.name for setting in settings()}
    for section, table in values.items():
        if section not in known_sections:
            instead = _suggestion(section, known | set(known_sections))
            raise RunFileError(f"{source}: {section} is no section{instead or _choice(known_sections)}")
        if not isinstance(table, dict):
            raise RunFileError(f"{source}: {section} = {_show(table)}: should be a table, [{section}]")
        for key in table:
            if f"{section}.{key}" not in known:
                raise RunFileError(
                    f"{source}: {section}.{key} is no setting{_suggestion(f'{section}.{key}', known)}"
                )


def _choice(names: Iterable[str]) -> str:
    return f", it should be one of {', '.join(names)}"


def _suggestion(name: str, known: set[str]) -> str:
    return "".join(f"; did you mean {near}?" for near in list(_near(name, known))[:1])


def _near(name: str, known: set[str]) -> Iterator[str]:
    """Yield known names that resemble `name`: as a whole first, then by their last part alone."""
    yield from difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.75)
    by_key = {setting.key: setting.name for setting in settings() if setting.name in known}
    key = name.rpartition(".")[2]
    yield from (by_key[near] for near in difflib.get_close_matches(key, sorted(by_key), n=1, cutoff=0.6))
    yield from difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.5)


def _describe(error: ValidationError, source: str, overridden: dict[str, str]) -> str:
    details = error.errors(include_url=False)
    first = details[0]
    name = ".".join(str(part) for part in first["loc"])
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    if not name:  # a check between two settings, whose text names both
        return f"{source}: {first['msg'].removeprefix('Value error, ')}{more}"
    place = (
        f"--set {overridden[name]}" if name in overridden else f"{source}: {name} = {_show(first['input'])}"
    )
    return f"{place}: should be {_expectation(name, first)}{more}"


def _expectation(name: str, detail: ErrorDetails) -> str:
    setting = next(setting for setting in settings() if setting.name == name)
    if detail["type"] == "string_pattern_mismatch":
        return f"text like {to_toml_value(setting.default)} ({setting.description})"
    return f"{setting.expected} ({setting.description})"


def _show(value: Any) -> str:
    shown = to_toml_value(value) if isinstance(value, bool | int | float | str) else repr(value)
    return _one_line(shown if len(shown) <= 60 else f"{shown[:57]}...")


def _one_line(text: str) -> str:
    return " ".join(text.split())
