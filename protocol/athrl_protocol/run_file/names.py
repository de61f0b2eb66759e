"""The valid names in a run file, and the nearest one to an unknown name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.documentation import sections, settings
from athrl_protocol.run_file.planner_tables import declared_planners, kinds_with
from athrl_protocol.run_file.toml_values import choice, cut, show, to_toml_value


class KnownNames:
    """Sections and settings of a run with a planner of kind `kind`."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._sections = list(sections())
        self._settings = {setting.name: setting.key for setting in settings(kind)}

    def check_tables(self, values: Mapping[str, Any], source: str) -> None:
        """Raise RunFileError unless every table is a section and every key one of its settings."""
        for section, table in values.items():
            if section not in self._sections:
                raise RunFileError(f"{source}: {cut(section)} is no section{self._nearest_section(section)}")
            if not isinstance(table, dict):
                raise RunFileError(f"{source}: {section} = {show(table)}: should be a table, [{section}]")
            for key in table:
                self.check_setting(f"{section}.{key}", source)

    def check_setting(self, name: str, place: str) -> None:
        """Raise RunFileError, which begins with `place`, unless `name` is a setting."""
        section, _, key = name.partition(".")
        if name in self._settings:
            return
        if name in self._sections:
            first = next(setting for setting in self._settings if setting.startswith(f"{name}."))
            raise RunFileError(f"{place}: {name} is no setting but a section of them, such as {first}")
        if section == "planner" and key:
            if not declared_planners():
                return
            others = kinds_with(key)
            if others:
                raise RunFileError(
                    f"{place}: {cut(name)} is a setting of planner.kind = {choice(others)}, "
                    f"and this run has planner.kind = {to_toml_value(self._kind)}"
                )
        raise RunFileError(f"{place}: {cut(name)} is no setting{self._nearest(name, self._settings)}")

    def _nearest_section(self, name: str) -> str:
        nearest = self._nearest(name, [*self._settings, *self._sections])
        return nearest or f", it should be one of {', '.join(self._sections)}"

    def _nearest(self, name: str, known: Iterable[str]) -> str:
        return "".join(f"; did you mean {near}?" for near in list(self._near(name, sorted(known)))[:1])

    def _near(self, name: str, known: list[str]) -> Iterator[str]:
        """Yield known names that resemble `name`: first as a whole, then by their last part."""
        yield from difflib.get_close_matches(name, known, n=1, cutoff=0.75)
        by_key = {key: full for full, key in self._settings.items()}
        key = name.rpartition(".")[2]
        yield from (by_key[near] for near in difflib.get_close_matches(key, sorted(by_key), n=1, cutoff=0.6))
        yield from difflib.get_close_matches(name, known, n=1, cutoff=0.5)
