"""A run can only be resumed with its own planner: others cannot use its networks or experience."""

from __future__ import annotations

from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

import onnx
from athrl_protocol import RunFile, RunFileError
from athrl_protocol.run_file.document import read_document
from athrl_spaces import Action, Continuous, LevelDescription, PolicyDescription
from athrl_spaces.policy import LARGEST_ARTEFACT, METADATA_KEY, InvalidDescription
from athrl_spaces.untrusted import parser_errors, read_untrusted
from google.protobuf.message import DecodeError

from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.errors import SettingsDoNotFit
from athrl_learner.run_folder import RunFolder

SECTIONS_THAT_SHAPE = ("environment", "planner", "replay", "actor")
"""Sections of the run file that determine a planner's sizes and its experience."""


def require_same_policy(
    folder: RunFolder, content: CheckpointContent | None, now: PolicyDescription, run_file: RunFile
) -> None:
    """Refuse to resume a run whose planner, sizes or actions differ from the settings.

    The checkpoint describes the earlier run, or, without one, the policy that it published last. The
    exploration may change.

    Raises:
        SettingsDoNotFit: one line with the old and the new value; nothing was changed.
    """
    before = _trained_before(folder, content)
    if before is None:
        return
    if before.planner != now.planner:
        raise SettingsDoNotFit(
            f"the run in {folder.path}",
            f"it was trained as {before.planner}, planner.kind is {now.planner}: "
            "resume it as it was, or choose another run.name",
        )
    difference = next(_differences(before, now), None)
    if difference is not None:
        what = f"the run in {folder.path}"
        raise SettingsDoNotFit(what, changed_settings(folder, content, run_file) or difference)


def require_same_meaning(
    folder: RunFolder, content: CheckpointContent | None, kept: Set[str], run_file: RunFile
) -> None:
    """Refuse to resume a run with another value of a planner's setting that a run keeps.

    Raises:
        SettingsDoNotFit: one line with the old and the new value; nothing was changed.
    """
    before, now = _settings_of(folder, content).get("planner", {}), run_file.planner.values()
    for key in sorted(kept & before.keys()):
        if now[key] != before[key]:
            what = f"the run in {folder.path}"
            raise SettingsDoNotFit(what, f"planner.{key} was {before[key]!r} and is {now[key]!r}")


def changed_settings(folder: RunFolder, content: CheckpointContent | None, run_file: RunFile) -> str:
    """Settings of planner and experience that have changed, as text; empty if none has."""
    before, now = _settings_of(folder, content), run_file.model_dump()
    return ", ".join(
        f"{section}.{key} was {was!r} and is {now[section][key]!r}"
        for section in SECTIONS_THAT_SHAPE
        for key, was in before.get(section, {}).items()
        if key in now[section] and now[section][key] != was
    )


def _trained_before(folder: RunFolder, content: CheckpointContent | None) -> PolicyDescription | None:
    """The description of the run's policy; None if it cannot be read any more."""
    try:
        if content is not None:
            return PolicyDescription.from_json(content.state["policy"])
        return PolicyDescription.from_json(_metadata(folder.latest_policy))
    except (KeyError, InvalidDescription):
        return None  # each chunk of the log is checked against the settings as well


def _metadata(artefact: Path) -> str:
    with parser_errors(InvalidDescription, DecodeError):
        model = onnx.load_from_string(read_untrusted(artefact, LARGEST_ARTEFACT))
    return {entry.key: entry.value for entry in model.metadata_props}.get(METADATA_KEY, "")


def _settings_of(folder: RunFolder, content: CheckpointContent | None) -> dict[str, Any]:
    """The settings of the checkpoint, or else of the run file in the folder; empty if it cannot be read."""
    if content is not None:
        return dict(content.state["run_file"])
    try:
        return read_document(folder.run_toml)
    except RunFileError:
        return {}


def _differences(before: PolicyDescription, now: PolicyDescription) -> Iterator[str]:
    """All differences but the exploration, in words."""
    if before.observation != now.observation:
        yield f"it saw {before.observation}, the planner sees {now.observation}"
    if before.limits != now.limits:
        yield f"its environments had {before.limits}, the settings have {now.limits}"
    names = [level.name for level in before.levels], [level.name for level in now.levels]
    if names[0] != names[1]:
        yield f"its levels were {', '.join(names[0])}, the planner's are {', '.join(names[1])}"
    for was, level in zip(before.levels, now.levels, strict=False):
        if _decided(was) != _decided(level):
            yield f"its level {was.name} decided {_decided(was)}, the planner's decides {_decided(level)}"
        if was.rewarded != level.rewarded:
            yield f"its level {was.name} was rewarded by {_reward(was)}, the planner's is by {_reward(level)}"
        if was.state_size != level.state_size:
            yield (
                f"its level {was.name} remembered {was.state_size} numbers, the planner's remembers "
                f"{level.state_size}"
            )


def _reward(level: LevelDescription) -> str:
    return " + ".join(level.rewarded) or "the task's reward"


def _decided(level: LevelDescription) -> str:
    return ", ".join(map(_in_words, level.actions))


def _in_words(action: Action) -> str:
    if isinstance(action, Continuous):
        return f"{action.name} {action.low:g}..{action.high:g} {action.unit}".rstrip()
    return f"{action.name} of {', '.join(action.choices)}"
