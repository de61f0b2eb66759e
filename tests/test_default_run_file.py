"""The run file and the reference page that lie in the checkout are what the settings say."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from athrl_protocol.run_file import RunFile, declare_planners, declared_planners, read_run_file

ROOT = Path(__file__).parents[1]


@pytest.fixture
def generate() -> Iterator[ModuleType]:
    """The program that writes the files; what it declares is taken back afterwards."""
    before = declared_planners()
    specification = importlib.util.spec_from_file_location("generate", ROOT / "presets" / "generate.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    yield module
    declare_planners(before)


def test_run_file_and_reference_page_in_the_checkout_are_current(generate: ModuleType) -> None:
    for path, content in generate.contents().items():
        assert path.read_text() == content, "run presets/generate.py"


def test_default_preset_is_the_default(generate: ModuleType) -> None:
    generate.contents()
    assert read_run_file(ROOT / "presets" / "default.toml", complete=True) == RunFile()
