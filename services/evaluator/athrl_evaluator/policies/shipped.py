"""Policies that come with the package, by name, each with a card that says what it is.

A policy NAME is two files in `policies/`: `NAME.onnx`, and the card, `NAME.json`:

    {"planner": "athrl", "purpose": "...", "trained": "...", "commit": "...", "decisions": 400000,
     "town": "town03", "limits": ["...", "..."], "sha256": "...",
     "scores": {"policy": {"return_mean": ..., "return_ci95": ..., ...}, "rule-based": {...}}}
"""

from __future__ import annotations

import difflib
import hashlib
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from athrl_driving.policy import OnnxPolicy
from athrl_spaces.untrusted import parser_errors, read_json

from athrl_evaluator.errors import EvaluatorError

FOLDER = Path(__file__).parent


class UnknownPolicy(EvaluatorError):  # noqa: N818  (the name says what is wrong)
    """There is no policy of that name."""


@dataclass(frozen=True)
class PolicyCard:
    """The description of a policy.

    Attributes:
        planner: kind of the planner.
        purpose: in one line.
        trained: how, in one line: command, time and machine.
        commit: of the program that trained it.
        decisions: number of decisions that it was trained on.
        town: or towns, of the training and the scores.
        scores: of the policy and of others on the same episodes, as `athrl evaluate --json` prints them.
        limits: conditions that it is not made for or has not been tested in.
        sha256: of the policy's file.
    """

    planner: str
    purpose: str
    trained: str
    commit: str
    decisions: int
    town: str
    scores: dict[str, dict[str, float]]
    limits: list[str]
    sha256: str


def shipped_policies() -> dict[str, PolicyCard]:
    """The cards of all policies of the package, by name.

    Raises:
        EvaluatorError: a card is damaged.
    """
    return {path.stem: read_card(path) for path in sorted(FOLDER.glob("*.json"))}


def shipped_names() -> list[str]:
    """Names of all policies that came with the package."""
    return [path.stem for path in sorted(FOLDER.glob("*.onnx"))]


def shipped_policy(name: str) -> Path:
    """The file of a policy that came with the package.

    Raises:
        UnknownPolicy: there is none of that name.
    """
    names = shipped_names()
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
        there = f"there are {', '.join(names)}" if names else "this package has none"
        hint = f"; did you mean {near[0]}?" if near else ""
        raise UnknownPolicy(f"there is no policy {name!r}, {there}{hint}")
    return FOLDER / f"{name}.onnx"


def read_card(path: Path) -> PolicyCard:
    """Read a card.

    Raises:
        EvaluatorError: it cannot be read, or is not a card.
    """
    with parser_errors(lambda reason: EvaluatorError(f"{path} is no card of a policy: it {reason}")):
        document = read_json(path)
    wanted = {field.name for field in fields(PolicyCard)}
    if not isinstance(document, dict) or not wanted <= document.keys():
        raise EvaluatorError(f"{path} is no card of a policy: it should have {', '.join(sorted(wanted))}")
    return PolicyCard(**{name: document[name] for name in wanted})


def ship(artefact: bytes, name: str, folder: Path = FOLDER, **told: Any) -> Path:
    """Put a policy and its card into the package; returns the policy's file.

    Args:
        artefact: the policy.
        name: by which it will be called.
        folder: of the policies.
        told: the card's fields except `planner` and `sha256`, which follow from the policy.

    Raises:
        InvalidPolicy: it is no policy.
    """
    card = PolicyCard(
        planner=OnnxPolicy(artefact).description.planner,
        sha256=hashlib.sha256(artefact).hexdigest(),
        **told,
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(asdict(card), indent=2) + "\n", encoding="utf-8")
    path = folder / f"{name}.onnx"
    path.write_bytes(artefact)
    return path
