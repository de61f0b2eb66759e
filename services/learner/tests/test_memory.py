"""A replay that can never be allocated is refused before the run starts."""

from pathlib import Path

import pytest
from athrl_learner.errors import TooLittleMemory
from athrl_learner.training import memory


@pytest.fixture
def limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that says the container's limit."""
    path = tmp_path / "memory.max"
    monkeypatch.setattr(memory, "LIMIT_FILES", (tmp_path / "missing", path))
    return path


def test_more_than_the_container_may_use_is_refused(limited: Path) -> None:
    limited.write_text(f"{2**30}\n")
    memory.require_memory(2**29, 1000)
    with pytest.raises(TooLittleMemory, match=r"2\.0 GiB of memory, more than the 1\.0 that"):
        memory.require_memory(2**31, 1000)


@pytest.mark.parametrize("content", ["max\n", "9223372036854771712\n", ""])
def test_container_without_a_limit_has_the_machines_memory(limited: Path, content: str) -> None:
    limited.write_text(content)
    memory.require_memory(2**31, 1000)
