"""Where a policy is scored: in the town of its run, and elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from athrl_protocol.run_file.sections import EnvironmentSection
from athrl_protocol.run_file.toml_values import show, to_toml_value

from athrl.errors import needs
from athrl.study.file import ElsewhereSection, StudyFile, StudyFileError, numbered
from athrl.study.plan import PlannedRun, require_town

_OF_A_CASE_STUDY = frozenset({"towns", "vehicles", "episode_ticks"})
"""Settings of an environment that a case study has of its own."""


@dataclass(frozen=True)
class Place:
    """Episodes of one kind.

    Attributes:
        towns: of which each has so many episodes; none for a case study.
        case_study: one of the paper's, or None.
        vehicles: background vehicles; None leaves the run's number.
        episodes: in each town.
        first_seed: of the episodes.
    """

    towns: tuple[str, ...]
    case_study: str | None
    vehicles: int | None
    episodes: int
    first_seed: int

    def words(self, driver: str, environment: EnvironmentSection) -> list[str]:
        """Return the words of `athrl evaluate` that score a driver here, else in a run's environment."""
        left_out = {"towns"} if self.case_study is None else _OF_A_CASE_STUDY
        settings = environment.model_dump(exclude=set(left_out))
        if self.vehicles is not None:
            settings["vehicles"] = self.vehicles
        if self.case_study is None:
            settings["towns"] = list(self.towns)
        where = [] if self.case_study is None else ["--case-study", self.case_study]
        return [
            *("evaluate", "--policy", driver, *where, "--json"),
            *("--episodes", str(self.episodes), "--seed", str(self.first_seed)),
            *(word for key, value in settings.items() for word in _setting(f"environment.{key}", value)),
        ]


def home(study: StudyFile, run: PlannedRun) -> Place:
    """Return where a run is at home: in each of its towns, with its own number of vehicles."""
    scoring = study.scoring
    return Place(run.row.towns, None, None, scoring.episodes, scoring.first_seed)


def elsewhere(study: StudyFile, section: ElsewhereSection) -> Place:
    """Return the place that a section of the study describes."""
    towns = () if section.town is None else (section.town,)
    episodes = section.episodes or study.scoring.episodes
    return Place(towns, section.case_study, section.vehicles, episodes, study.scoring.first_seed)


def require_places(path: Path, study: StudyFile, runs: Sequence[PlannedRun]) -> None:
    """Check the places of a study: those of its runs, and elsewhere.

    Raises:
        StudyFileError: two have one name, a town is none or has too little room.
    """
    require_room_at_home(path, runs)
    names: set[str] = set()
    for number, section in enumerate(study.elsewhere):
        place = f"{path}: {numbered('elsewhere', number)}"
        if section.name in names:
            raise StudyFileError(f"{place}, name: {show(section.name)} appears twice, it should appear once")
        names.add(section.name)
        if section.town is not None:
            require_town(f"{place}, town", section.town)
            _require_room_elsewhere(place, section, section.town, runs)


def require_room_at_home(path: Path, runs: Sequence[PlannedRun]) -> None:
    """Raise StudyFileError for a run whose town has too little room, or cannot be read as it says."""
    for (town, strict, vehicles), run in _worlds(runs).items():
        place = f"{path}: {run.name}"
        room = _room(place, town, strict)
        if vehicles > room:
            raise StudyFileError(
                f"{place}: environment.vehicles is {vehicles}, {town} has room for {room} at most"
            )


def _worlds(runs: Sequence[PlannedRun]) -> dict[tuple[str, bool, int], PlannedRun]:
    """Return the first run of each town, way to read it and number of vehicles."""
    found: dict[tuple[str, bool, int], PlannedRun] = {}
    for run in runs:
        environment = run.settings.environment
        for town in run.row.towns:
            found.setdefault((town, environment.strict_map, environment.vehicles), run)
    return found


def _require_room_elsewhere(
    place: str, section: ElsewhereSection, town: str, runs: Sequence[PlannedRun]
) -> None:
    """Check the room of a place for its own vehicles, or else for those of each run that is scored there."""
    kinds = {(run.settings.environment.strict_map, _vehicles(section, run)): run for run in reversed(runs)}
    for (strict, vehicles), run in kinds.items():
        room = _room(place, town, strict)
        if vehicles <= room:
            continue
        if section.vehicles is not None:
            raise StudyFileError(f"{place}, vehicles = {vehicles}: {town} has room for {room} at most")
        raise StudyFileError(
            f"{place}: has no vehicles of its own and {run.name} has environment.vehicles = {vehicles}, "
            f"{town} has room for {room} at most: give vehicles here"
        )


def _vehicles(section: ElsewhereSection, run: PlannedRun) -> int:
    return run.settings.environment.vehicles if section.vehicles is None else section.vehicles


def _room(place: str, town: str, strict: bool) -> int:
    """Return for how many vehicles a town has room; raises StudyFileError where it cannot be read so."""
    with needs("evaluator"):
        from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
        from athrl_driving.maps import load_town
    try:
        return places_beside_an_ego(load_town(town, strict=strict))
    except ValueError as error:
        raise StudyFileError(f"{place}: {error}") from None


def _setting(name: str, value: object) -> tuple[str, str]:
    return "--set", f"{name}={to_toml_value(value)}"
