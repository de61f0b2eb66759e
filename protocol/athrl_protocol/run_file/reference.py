"""The reference page: every setting of every section and of every declared kind of planner."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from athrl_protocol.run_file.documentation import (
    Setting,
    planner_settings,
    sections,
    settings,
)
from athrl_protocol.run_file.planner_tables import declared_planners
from athrl_protocol.run_file.toml_values import choice, to_toml_value

_INTRODUCTION = """# Settings

A run file, in TOML, describes a run. Missing settings have the defaults that are given here; a setting on the
command line overrides the file: `--set learner.batch=64`. Errors are reported in one line before anything
starts. A file has at most 1 MiB, an integer 64 bits, a text one line.
[`presets/default.toml`](../presets/default.toml) has every setting of the default run.

This page is written by `python presets/generate.py`."""


def reference_page() -> str:
    """Return the page as Markdown; settings that all kinds of planner share are listed once."""
    everything = list(settings())
    lines = [_INTRODUCTION]
    for name, section in sections().items():
        lines += ["", f"## [{name}]", "", (section.__doc__ or "").strip(), ""]
        if name == "planner":
            lines += _planners([setting for setting in everything if setting.name == "planner.kind"])
        else:
            lines += _table(setting for setting in everything if setting.section == name)
    return "\n".join(lines) + "\n"


def _planners(kind: list[Setting]) -> Iterator[str]:
    """Tables of the planners' settings: first those of all kinds, then those of some kinds."""
    of_kind = {kind: list(planner_settings(kind)) for kind in declared_planners()}
    groups: dict[tuple[str, ...], list[Setting]] = {tuple(of_kind): kind}
    for settings_of_one in of_kind.values():
        for setting in settings_of_one:
            having = tuple(kind for kind, others in of_kind.items() if setting in others)
            group = groups.setdefault(having, [])
            if setting not in group:
                group.append(setting)
    yield from _table(groups.pop(tuple(of_kind)))
    for having, group in groups.items():
        yield from ("", f"### planner.kind = {choice(having)}", "")
        yield from _table(group)


def _table(rows: Iterable[Setting]) -> Iterator[str]:
    yield "| setting | default | may be | meaning |"
    yield "|---|---|---|---|"
    for setting in rows:
        default, expected = _cell(f"`{to_toml_value(setting.default)}`"), _cell(setting.expected)
        yield f"| `{setting.key}` | {default} | {expected} | {_cell(setting.description)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
