"""Who may know whom: the rooms' imports and what their installation brings along."""

import ast
import importlib.metadata
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]

# A room's folder, its import name, and the rooms that it may import.
ROOMS = {
    "spaces": ("athrl_spaces", set()),
    "protocol": ("athrl_protocol", {"athrl_spaces"}),
    "driving": ("athrl_driving", {"athrl_spaces"}),
    "planners": ("athrl_planners", {"athrl_spaces"}),
    "services/actor": ("athrl_actor", {"athrl_spaces", "athrl_protocol", "athrl_driving"}),
    "services/learner": ("athrl_learner", {"athrl_spaces", "athrl_protocol", "athrl_planners"}),
    "services/evaluator": ("athrl_evaluator", {"athrl_spaces", "athrl_protocol", "athrl_driving"}),
    "athrl": (
        "athrl",
        {
            "athrl_spaces",
            "athrl_protocol",
            "athrl_driving",
            "athrl_planners",
            "athrl_actor",
            "athrl_learner",
            "athrl_evaluator",
        },
    ),
}
OURS = {name for name, _ in ROOMS.values()}


# Part of the command and yet of a service: imported only inside the subcommand that needs it, or, a program
# of its own, by nobody.
WITH_SERVICES = ("athrl.serial", "athrl.doctor.light_learner")


def imports(tree: ast.AST) -> Iterator[tuple[str, bool]]:
    """Yield the first name of every absolute import and whether it happens when the module is imported."""
    yield from ((module.split(".")[0], at_import) for module, at_import in modules(tree))


def modules(tree: ast.AST) -> Iterator[tuple[str, bool]]:
    """Yield the module of every absolute import and whether it happens when this one is imported."""

    def walk(node: ast.AST, at_import: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                yield from ((alias.name, at_import) for alias in child.names)
            elif isinstance(child, ast.ImportFrom) and child.level == 0 and child.module:
                yield child.module, at_import
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or for_types(
                child
            )
            yield from walk(child, at_import and not inside)

    return walk(tree, True)


def for_types(node: ast.AST) -> bool:
    """Whether it is what type checkers alone read: `if TYPE_CHECKING:`."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def sources(folder: str) -> list[Path]:
    """Return the Python files of a room's package."""
    files = sorted((ROOT / folder / ROOMS[folder][0]).rglob("*.py"))
    assert files
    return files


@pytest.mark.parametrize("folder", ROOMS)
def test_room_imports_only_the_rooms_it_may_know(folder: str) -> None:
    own, allowed = ROOMS[folder]
    for file in sources(folder):
        names = {name for name, _ in imports(ast.parse(file.read_text()))}
        assert names & OURS <= allowed | {own}, file


def test_command_imports_services_only_inside_the_subcommand_that_needs_them() -> None:
    services = OURS - {"athrl", "athrl_protocol", "athrl_spaces"}
    for file in sources("athrl"):
        if ".".join(file.relative_to(ROOT / "athrl").with_suffix("").parts).startswith(WITH_SERVICES):
            continue
        at_import = {module for module, at_import in modules(ast.parse(file.read_text())) if at_import}
        assert not {module.split(".")[0] for module in at_import} & services, file
        assert not any(module.startswith(WITH_SERVICES) for module in at_import), file


@pytest.mark.parametrize("folder", ROOMS)
def test_pyproject_names_only_the_rooms_it_may_know(folder: str) -> None:
    own, allowed = ROOMS[folder]
    project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
    named = {re.sub("-", "_", Requirement(line).name) for line in project["dependencies"]}
    assert named & OURS <= allowed | {own}


def closure(distribution: str) -> set[str]:
    """Return the names of all that installing the distribution installs, read off what is installed."""
    found: set[str] = set()
    waiting = [(distribution, frozenset[str]())]
    seen = set()
    while waiting:
        name, extras = waiting.pop()
        name = re.sub(r"[-_.]+", "-", name).lower()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        found.add(name)
        for line in importlib.metadata.distribution(name).requires or []:
            requirement = Requirement(line)
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in extras | {""}):
                waiting.append((requirement.name, frozenset(requirement.extras)))
    return found


@pytest.mark.parametrize("distribution", ["athrl-actor", "athrl-evaluator"])
def test_installing_driver_brings_no_torch(distribution: str) -> None:
    installed = closure(distribution)
    assert {"onnxruntime", "highway-env", "eclipse-zenoh"} <= installed
    assert not {"torch", "athrl-planners"} & installed


def test_installing_learner_brings_no_simulator() -> None:
    installed = closure("athrl-learner")
    assert {"torch", "eclipse-zenoh"} <= installed
    assert not {"highway-env", "gymnasium", "athrl-driving"} & installed


def test_no_file_has_over_400_lines() -> None:
    for folder in [*ROOMS, "tests", "benchmarks", "deploy"]:
        for file in (ROOT / folder).rglob("*.py"):
            if not file.name.endswith("_pb2.py"):
                assert len(file.read_text().splitlines()) <= 400, file
