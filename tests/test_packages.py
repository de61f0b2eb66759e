"""Every package builds as wheel and source distribution, and the wheels work together."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from build import ProjectBuilder

ROOT = Path(__file__).parents[1]
ROOMS = (
    *("spaces", "protocol", "driving", "accelerate", "planners"),
    *("services/actor", "services/learner", "services/evaluator", "athrl"),
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution of every room."""
    folder = tmp_path_factory.mktemp("dist")
    for room in ROOMS:
        builder = ProjectBuilder(ROOT / room)  # with the build tools of this environment: no network
        for kind in ("wheel", "sdist"):
            builder.build(kind, str(folder))
    return folder


def metadata(wheel: Path) -> dict[str, str]:
    """Return the head of a wheel's METADATA."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return dict(Parser().parsestr(archive.read(name).decode(), headersonly=True))


def test_every_package_has_one_version_and_the_licence(built: Path) -> None:
    heads = [metadata(wheel) for wheel in built.glob("*.whl")]
    assert len(heads) == len(ROOMS)
    assert {head["Version"] for head in heads} == {"0.2.0"}
    assert {head["License-Expression"] for head in heads} == {"MIT"}
    assert all(head["Summary"] for head in heads)


def test_changelog_tells_of_the_version() -> None:
    assert "## [0.2.0]" in (ROOT / "CHANGELOG.md").read_text()
    assert "version: 0.2.0\n" in (ROOT / "CITATION.cff").read_text()


def test_source_distributions_hold_what_wheels_hold(built: Path) -> None:
    for wheel in built.glob("*.whl"):
        (source,) = built.glob(f"{wheel.name.split('-')[0]}-*.tar.gz")
        with zipfile.ZipFile(wheel) as archive, tarfile.open(source) as tar:
            inside = {name.partition("/")[2] for name in tar.getnames()}
            wanted = {name for name in archive.namelist() if ".dist-info/" not in name}
        assert wanted <= inside, f"{source.name} lacks {sorted(wanted - inside)[:3]}"


def test_wheels_install_from_a_folder_without_network_and_work_together(built: Path, tmp_path: Path) -> None:
    target = tmp_path / "installed"
    names = [metadata(wheel)["Name"] for wheel in built.glob("*.whl")]
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    offline = ["--no-index", "--find-links", str(built), "--no-deps", "--target", str(target)]
    subprocess.run([*pip, *offline, *names], check=True, timeout=240)
    # Other packages come from this environment; ours come first from the folder.
    environment = {**os.environ, "PYTHONPATH": str(target)}

    def output(*words: str) -> str:
        return subprocess.run(
            [sys.executable, *words],
            env=environment, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=240,
        ).stdout  # fmt: skip

    assert str(target) in output("-c", "import athrl; print(athrl.__file__)")
    assert "0.2.0" in output("-m", "athrl", "--version")
    assert "town03" in output("-m", "athrl", "policies")
    load = "from athrl_driving.maps import load_town; print(len(load_town('town03').graph.length))"
    assert int(output("-c", load)) > 100
    assert "accelerate" in output("-c", "import athrl_accelerate; print(athrl_accelerate.__all__)")
