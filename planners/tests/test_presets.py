"""The presets of the papers are run files that are valid, and the papers' in what the settings can say."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import athrl_planners
import pytest
from athrl_planners import planner, settings_tables

run_files = pytest.importorskip("athrl_protocol.run_file")

FOLDER = Path(__file__).parents[2] / "presets"
PRESETS = sorted(FOLDER.glob("paper-*.toml"))
KINDS, TOWNS = ("athrl", "hddpg", "ddpg", "hdqn"), ("town02", "town03", "town04")

OF_ALL = {
    "encoder": "paper",
    "memory": "lstm",
    "shared_trunk": False,
    "recurrent_features": 40,
    "critic": "scalar",
    "critics": 1,
    "loss": "huber",
    "n_step": 1,
    "tau": 0.005,
    "end_penalty": 0.0,
    "reward_scale": 1.0,
    "final_learning_rate": 1.0,
    "average_decay": 0.0,
    "mirror": False,
}
OF_ACTORS = {
    "update_rule": "ddpg",
    "discount": 0.99,
    "learning_rate": 3e-4,
    "noise_low": 0.2,
    "noise_high": 0.2,
    "noise_damping": 0.15,
    "saturation_penalty": 0.0,
    "action_reach": 1.0,
}
OF_WAYPOINTS = {"maximum_speed": 8.0, "waypoint_half_angle": 90.0, "waypoint_radius": 8.0, "speed_gain": 0.7}
OF_HDQN = {
    "discount": 0.95,
    "learning_rate": 1e-3,
    "epsilon_low": 0.05,
    "epsilon_high": 0.05,
    "double": False,
    "dueling": False,
}


@pytest.fixture(autouse=True)
def _declared() -> Iterator[None]:
    before = run_files.declared_planners()
    run_files.declare_planners(settings_tables())
    yield
    run_files.declare_planners(before)


def flat(document: dict[str, Any]) -> dict[str, Any]:
    return {f"{section}.{key}": value for section, body in document.items() for key, value in body.items()}


def test_every_planner_has_one_for_town03_and_the_papers_two_for_every_town() -> None:
    expected = {f"paper-{kind}-town03.toml" for kind in KINDS}
    expected |= {f"paper-{kind}-{town}.toml" for kind in ("athrl", "hdqn") for town in TOWNS}
    assert {preset.name for preset in PRESETS} == expected


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.stem)
def test_preset_is_a_valid_run_file_of_its_planner_and_town(preset: Path) -> None:
    _, kind, town = preset.stem.split("-")
    run_file = run_files.read_run_file(preset)
    assert run_file.planner.kind == kind
    assert run_file.environment.towns == {town: 1.0}
    assert run_file.run.name == preset.stem
    planner(kind).read_settings(run_file.planner.values())


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.stem)
def test_preset_begins_with_its_purpose_and_says_only_what_differs(preset: Path) -> None:
    first = preset.read_text().splitlines()[0]
    assert first.startswith("# ")
    assert first.endswith(".")
    written = flat(tomllib.loads(preset.read_text()))
    kind = written.pop("planner.kind")
    defaults = flat(run_files.RunFile(planner={"kind": kind}).model_dump())
    assert written
    for key, value in written.items():
        assert key in defaults
        assert (key == "environment.towns" and value == "town03") or value != defaults[key], key


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.stem)
def test_preset_is_the_papers_recipe(preset: Path) -> None:
    run_file = run_files.read_run_file(preset)
    settings = planner(run_file.planner.kind).read_settings(run_file.planner.values())
    assert run_file.exploration.random_decisions == 10_000
    assert run_file.run.environment_steps == 40_000
    assert run_file.learner.samples_per_insert == run_file.learner.batch  # one update a decision
    assert run_file.learner.batch == 128 * run_file.replay.sequence_length
    assert run_file.replay.capacity == 100_000
    assert settings.model_dump() | OF_ALL == settings.model_dump()
    environment = run_file.environment.model_dump()
    assert run_file.planner.kind == "ddpg" or environment | OF_WAYPOINTS == environment
    own = OF_HDQN if run_file.planner.kind == "hdqn" else OF_ACTORS
    assert settings.model_dump() | own == settings.model_dump()


def rows() -> list[tuple[str, str, str, str]]:
    """Kind, key, default as it is written, and the paper's value, of every row that names a setting."""
    found = []
    for kind in KINDS:
        page = Path(athrl_planners.__file__).parent / kind / "README.md"
        for line in page.read_text().splitlines():
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            setting = re.match(r"`([\w.]+) = ([^`]+)`", cells[-1])
            if line.startswith("| ") and setting:
                default = re.search("`([^`]+)`", cells[2])
                assert default, line
                found.append((kind, setting[1], default[1], setting[2]))
    return found


@pytest.mark.parametrize(("kind", "key", "default", "of_the_paper"), rows())
def test_deviations_name_settings_and_defaults_that_there_are(
    kind: str, key: str, default: str, of_the_paper: str
) -> None:
    section, name = key.split(".") if "." in key else ("planner", key)
    defaults = run_files.RunFile(planner={"kind": kind}).model_dump()
    assert defaults[section][name] == tomllib.loads(f"value = {default}")["value"]
    value = tomllib.loads(f"value = {of_the_paper}")["value"]
    sections: dict[str, dict[str, Any]] = {"planner": {"kind": kind}}
    sections.setdefault(section, {})[name] = value
    changed = run_files.RunFile(**sections)
    assert changed.model_dump()[section][name] == value


def test_deviations_cover_every_setting_of_a_planner_but_those_of_other_rules() -> None:
    """What is not in the pages has no counterpart in the paper."""
    ours = {"atoms", "value_min", "value_max", "td3_actor_delay", "td3_target_noise"}
    ours |= {"sac_temperature", "sac_target_entropy"}
    of_all = {key for kind, key, *_ in rows() if kind == "athrl"}
    for kind in KINDS:
        named = of_all | {key for page, key, *_ in rows() if page == kind}
        assert set(planner(kind).settings.model_fields) - ours <= named
