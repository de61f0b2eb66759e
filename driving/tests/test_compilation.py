"""Machine code is kept where it can be written, and never taken for that of other sources."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from athrl_driving import compilation


def folder() -> str:
    return compilation.cache_folder.__wrapped__()


def test_the_users_choice_of_folder_is_respected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert Path(folder()).parent == tmp_path / "chosen"


def test_a_folder_that_cannot_be_written_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_folder = tmp_path / "file"
    no_folder.touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(no_folder))
    monkeypatch.setattr(compilation, "_PACKAGE", no_folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert Path(folder()).parent == tmp_path / "home"
    monkeypatch.setenv("XDG_CACHE_HOME", str(no_folder))
    assert Path(folder()).is_dir()


def test_changed_kernels_get_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    (tmp_path / "traffic").mkdir()
    source = tmp_path / "traffic" / "tick.py"
    source.write_text("one")
    before = folder()
    source.write_text("two")
    assert folder() != before


_SMALL_KERNEL = """
import sys, time
import os
import subprocess
import sys
from pathlib import Path
from athrl_driving import compilation

@compilation.compiled
def small(x):
    return x + 1

print("ready", flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.01)
with compilation.compiled_once(small, 1):
    small(1)
    time.sleep(0.5)
print("compiled" if small.stats.cache_misses else "loaded")
"""


def test_of_processes_that_start_together_one_compiles_and_the_others_take_its_code(tmp_path: Path) -> None:
    script, start = tmp_path / "small.py", tmp_path / "start"
    script.write_text(_SMALL_KERNEL)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "code")}
    processes = [
        subprocess.Popen(
            [sys.executable, str(script), str(start)], stdout=subprocess.PIPE, text=True, env=environment
        )
        for _ in range(3)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    start.touch()
    said = sorted(process.communicate(timeout=60)[0].strip() for process in processes)
    assert said == ["compiled", "loaded", "loaded"]
