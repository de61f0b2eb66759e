"""Run files and settings of the command line."""

from __future__ import annotations

import os
import random
import tomllib
from pathlib import Path

from athrl_planners.registry import settings_tables
from athrl_protocol import RunFileError, default_toml, read_run_file
from athrl_protocol.run_file import RunFile, declare_planners, saved_toml, settings
from athrl_protocol.run_file.toml_values import to_toml_value

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser

PRESETS = Path(__file__).parents[2] / "presets"


def run_file(folder: Path) -> Parser:
    """Return the parser of run files."""
    declare_planners(settings_tables())
    seeds = [default_toml().encode(), saved_toml(RunFile()).encode()]
    seeds += [path.read_bytes() for path in sorted(PRESETS.glob("*.toml"))]
    return file_parser(seeds, mutations.TEXT, folder / "run.toml", _read, RunFileError)


def served_run_file(folder: Path) -> Parser:
    """Return the parser of the run file that a learner serves; it needs no folder."""
    declare_planners(settings_tables())
    seeds = [RunFile().to_json().encode()]
    ways = [*mutations.TEXT, mutations.changed_json, mutations.changed_json]

    def broken(chance: random.Random) -> bytes:
        return chance.choice(ways)(chance, chance.choice(seeds))

    return Parser(seeds, broken, RunFile.from_json, (RunFileError,))


def override(folder: Path) -> Parser:
    """Return the parser of `--set` words; it needs no folder."""
    declare_planners(settings_tables())
    seeds = [f"{setting.name}={to_toml_value(setting.default)}".encode() for setting in settings()]

    def broken(chance: random.Random) -> bytes:
        return chance.choice(mutations.TEXT)(chance, chance.choice(seeds))

    def parse(word: bytes) -> None:
        _doubt(read_run_file(None, [os.fsdecode(word)]))  # as Python reads the command line

    return Parser(seeds, broken, parse, (RunFileError,))


def _read(path: Path) -> None:
    _doubt(read_run_file(path))


def _doubt(accepted: RunFile) -> None:
    """Look whether what was read can be written and served."""
    assert RunFile.from_json(accepted.to_json()) == accepted
    assert RunFile.model_validate(tomllib.loads(saved_toml(accepted))) == accepted
