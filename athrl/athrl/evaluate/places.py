"""Where is driven: towns or the paper's case studies, and with which settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from athrl_protocol.run_file import EnvironmentSection
from athrl_protocol.run_file.towns import read_towns
from athrl_spaces import CASE_STUDIES

from athrl.errors import CommandError, needs
from athrl.train.plan import require_world

ALL_CASE_STUDIES = "all"


@dataclass(frozen=True)
class Place:
    """A place where episodes are driven.

    Attributes:
        section: settings of the environments.
        case_study: the case study, if it is one.
        facts: fields of the results that describe the place.
        folder: subfolder of its recordings, if there are several places.
    """

    section: EnvironmentSection
    case_study: str | None
    facts: dict[str, str]
    folder: str


def places_of(section: EnvironmentSection, case_study: str | None, named: set[str]) -> list[Place]:
    """Return one place for each case study, or else for each town."""
    if case_study is not None:
        beside = _beside_case_study(section, named)
        studies = list(CASE_STUDIES) if case_study == ALL_CASE_STUDIES else (case_study,)
        return [Place(beside, study, {"case_study": study}, study) for study in studies]
    with needs("evaluator"):
        from athrl_evaluator.scoring.environments import in_town, town_labels
    labels = town_labels(list(section.towns))
    return [Place(in_town(section, town), None, {"town": town}, label) for town, label in labels.items()]


def require_room(places: Sequence[Place]) -> None:
    """Refuse more vehicles than a place has room for; a case study has fewer, unless they are given."""
    with needs("evaluator"):
        from athrl_evaluator.scoring.case_studies import case_study_settings
        from athrl_evaluator.scoring.environments import in_town
    for place in places:
        if place.case_study is None:
            require_world(place.section)
        elif "vehicles" in place.section.model_fields_set:
            require_world(in_town(place.section, case_study_settings(place.case_study)["town"]))


def check_town(town: str, vehicles: int = 0) -> None:
    """Refuse an unknown town and a map that cannot be driven or has too little room, by the option's name.

    Raises:
        CommandError: the town is one of these.
    """
    with needs("evaluator"):
        from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
        from athrl_driving.maps import load_town
    try:
        places = places_beside_an_ego(load_town(town))
    except ValueError as error:
        raise CommandError(f"--town {town}: {error}") from None
    if vehicles > places:
        raise CommandError(f"--vehicles {vehicles}: {town} has room for {places} at most")


def check_towns(towns: list[str]) -> None:
    """Refuse the towns of `--town` as `check_town` does, and one that is given twice."""
    for town in towns:
        check_town(town)
    try:
        if towns:
            read_towns(towns)
    except ValueError as error:
        raise CommandError(f"--town {error}") from None


def beside_policy(section: EnvironmentSection, named: set[str]) -> EnvironmentSection:
    """Settings of a policy's own run: of what follows from the policy itself only what is given is kept."""
    with needs("evaluator"):
        from athrl_evaluator.scoring.environments import FIXED_BY_POLICY
    own = FIXED_BY_POLICY - {name.removeprefix("environment.") for name in named}
    return EnvironmentSection(**section.model_dump(include=section.model_fields_set - own))


def _beside_case_study(section: EnvironmentSection, named: set[str]) -> EnvironmentSection:
    """Settings for a case study: of those that it fixes itself only the command line's are kept."""
    own = {"towns", "vehicles", "episode_ticks"} - {name.removeprefix("environment.") for name in named}
    return EnvironmentSection(**section.model_dump(include=section.model_fields_set - own))
