"""The house: which room may import which, no circles, short files, small folders, plain words."""

import ast
import importlib.metadata
import re
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import groupby
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]

# A room's folder, its import name, and the rooms that it may import.
ROOMS = {
    "spaces": ("athrl_spaces", set()),
    "protocol": ("athrl_protocol", {"athrl_spaces"}),
    "driving": ("athrl_driving", {"athrl_spaces"}),
    "accelerate": ("athrl_accelerate", {"athrl_driving"}),
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

BESIDE_THE_ROOMS = ("tests", "benchmarks", "deploy", "examples", "presets")

MOST_FILES = 24
"""Modules of one folder."""


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
    for folder in [*ROOMS, *BESIDE_THE_ROOMS]:
        for file in (ROOT / folder).rglob("*.py"):
            if not file.name.endswith("_pb2.py"):
                assert len(file.read_text().splitlines()) <= 400, file


@pytest.mark.parametrize("folder", ROOMS)
def test_no_folder_of_a_package_is_a_drawer_of_many_files(folder: str) -> None:
    for where, files in groupby(sources(folder), key=lambda file: file.parent):
        count = len(list(files))
        assert count <= MOST_FILES, f"{where} has {count} modules: group them"


@pytest.mark.parametrize("folder", ROOMS)
def test_modules_import_each_other_in_no_circle(folder: str) -> None:
    own = ROOMS[folder][0]
    files = {module_name(folder, file): file for file in sources(folder)}
    graph = {
        name: {target for target in imported(ast.parse(file.read_text()), set(files)) if target != name}
        for name, file in files.items()
        if name != own  # a package's first module collects what it shows
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"these import each other in a circle: {' -> '.join(error.args[1])}")


def module_name(folder: str, file: Path) -> str:
    """Return the dotted name of a room's file."""
    parts = file.relative_to(ROOT / folder).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def imported(tree: ast.AST, known: set[str]) -> Iterator[str]:
    """Yield the modules among `known` that a file imports, for types alone too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if name in known:
                    yield name
                elif node.module in known:
                    yield node.module


DIALECT = re.compile(
    r"\b(anew|whoever|whomever|for good and all|gives? way to be had|who is there|in vain|thither|whence"
    r"|(?:goes?|going) on (?:with|without|from|when)|lets none|as it were|be it)\b",
    re.IGNORECASE,
)
"""Words of a private dialect: "again", "every client", "the present services", "continues" say the same."""


def test_documents_are_in_plain_words() -> None:
    for page in documents():
        for number, line in enumerate(page.read_text().splitlines(), 1):
            found = DIALECT.search(line)
            assert found is None, f"{page.relative_to(ROOT)}, line {number}: {found and found[0]!r}"


@pytest.mark.parametrize("folder", ROOMS)
def test_messages_are_in_plain_words(folder: str) -> None:
    for file in sources(folder):
        tree = ast.parse(file.read_text())
        docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                found = DIALECT.search(node.value)
                assert found is None, f"{file.relative_to(ROOT)}, line {node.lineno}: {found and found[0]!r}"


LONGEST_CELL = 200


def test_no_cell_of_a_table_is_a_story() -> None:
    for page in documents():
        for number, line in enumerate(page.read_text().splitlines(), 1):
            if line.lstrip().startswith("|"):
                longest = max(map(len, line.split("|")))
                assert longest <= LONGEST_CELL, (
                    f"{page.relative_to(ROOT)}, line {number}: {longest} characters"
                )


def test_readme_fits_a_visitor() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def documents() -> list[Path]:
    """Return the pages that people read."""
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
    return pages + [page for folder in ROOMS for page in (ROOT / folder).rglob("README.md")]
