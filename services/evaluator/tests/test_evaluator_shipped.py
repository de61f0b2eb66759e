"""Policies of the package are found by name, with a card that describes them."""

import json
from pathlib import Path
from typing import Any

import pytest
from athrl_driving.policy import InvalidPolicy
from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.policies import shipped
from athrl_evaluator.policies.files import load_policy
from athrl_protocol.run_file import EnvironmentSection

CARD: dict[str, Any] = {
    "purpose": "Drives.",
    "trained": "athrl train, 5 minutes on 2 cores",
    "commit": "0123456",
    "decisions": 400_000,
    "town": "town03",
    "scores": {"policy": {"return_mean": 3200.0, "return_ci95": 80.0}},
    "limits": ["100 vehicles"],
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, artefact: bytes) -> Path:
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    shipped.ship(artefact, "town03", tmp_path, **CARD)
    return tmp_path


def test_policy_is_found_by_its_name_and_drives(folder: Path) -> None:
    file = shipped.shipped_policy("town03")
    environment = EnvironmentSection(vehicles=3, episode_ticks=20)
    settings = EvaluationSettings(episodes=2, seed=1, environment=environment)
    assert evaluate_driver(file, settings).episodes == 2


def test_card_says_what_the_policy_is(folder: Path) -> None:
    (card,) = shipped.shipped_policies().values()
    assert (card.planner, card.decisions, card.scores) == ("athrl", 400_000, CARD["scores"])


def test_name_that_does_not_exist_is_told_with_the_nearest(folder: Path) -> None:
    with pytest.raises(shipped.UnknownPolicy, match=r"no policy 'town3', .* did you mean town03"):
        shipped.shipped_policy("town3")


@pytest.mark.parametrize("name", ["../town03", "town03.onnx", ""])
def test_name_cannot_lead_out_of_the_folder(folder: Path, name: str) -> None:
    with pytest.raises(shipped.UnknownPolicy):
        shipped.shipped_policy(name)


def test_policy_that_is_not_the_cards_is_refused(folder: Path) -> None:
    file = shipped.shipped_policy("town03")
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(InvalidPolicy, match=r"town03\.onnx is not the policy that town03\.json"):
        load_policy(file)


@pytest.mark.parametrize("content", ["", "[]", '{"planner": "athrl"}'])
def test_damaged_card_is_named(folder: Path, content: str) -> None:
    (folder / "town03.json").write_text(content)
    with pytest.raises(EvaluatorError, match=r"town03\.json is no card of a policy"):
        shipped.shipped_policies()


def test_every_policy_of_the_package_is_what_its_card_says() -> None:
    for name, card in shipped.shipped_policies().items():
        assert load_policy(shipped.shipped_policy(name)).description.planner == card.planner
        assert json.dumps(card.scores)


def names_and_towns() -> list[tuple[str, str]]:
    cards = shipped.shipped_policies()
    return [(name, town) for name, card in cards.items() for town in card.town.split(", ")]


@pytest.mark.parametrize(("name", "town"), names_and_towns())
def test_policy_of_this_package_drives_as_its_card_says(name: str, town: str) -> None:
    card = shipped.shipped_policies()[name]
    file = shipped.shipped_policy(name)
    assert load_policy(file).description.planner == card.planner
    suffix = f" in {town}" if ", " in card.town else ""
    # A dozen episodes are far fewer than the card's, so only clearly worse scores are detected.
    settings = EvaluationSettings(episodes=12, seed=900_000, environment=EnvironmentSection(towns=town))
    scores = evaluate_driver(file, settings)
    assert scores.return_mean + scores.return_ci95 > 0.9 * card.scores[f"policy{suffix}"]["return_mean"]
    assert scores.return_mean > 0.8 * card.scores[f"rule-based{suffix}"]["return_mean"]


def test_policies_for_each_town_and_for_all_come_with_this_package() -> None:
    assert shipped.shipped_names() == ["town02", "town03", "town04", "towns"]
