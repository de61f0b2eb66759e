"""Machine code is cached in a writable folder, and never used for other sources."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from athrl_driving.episode.drive import drive
from athrl_driving.kernels import compilation


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


@pytest.mark.parametrize("module", ["action_kinds", "observation", "reward_terms"])
def test_changed_constants_get_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    before = compilation.fingerprint("athrl_driving")
    files = {file.stem: file for file in compilation._CONSTANTS}
    changed = tmp_path / files[module].name
    changed.write_bytes(files[module].read_bytes() + b"MAXIMUM_STEERING = 0.4")
    monkeypatch.setattr(compilation, "_CONSTANTS", list({**files, module: changed}.values()))
    assert compilation.fingerprint("athrl_driving") != before


_SMALL_KERNEL = """
import sys, time
import os
import subprocess
import sys
from pathlib import Path
from athrl_driving.kernels import compilation

@compilation.compiled
def small(x):
    return x + 1

print("ready", flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.01)
with compilation.compiled_once(small, "what is small", 1):
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


_READ_ONLY = """
import os
import sys
from pathlib import Path
from athrl_driving.kernels import compilation

if sys.argv[1] == "read-only":
    compilation._is_writable = lambda folder: False

@compilation.compiled
def small(x):
    return x + 1

with compilation.compiled_once(small, "what is small", 1):
    small(1)
print("compiled" if small.stats.cache_misses else "loaded", flush=True)
small(1.0)
if os.fork() == 0:
    sys.exit()  # removes nothing of its parent's
os.wait()
print(len(list(Path(compilation.cache_folder()).rglob("small.small-*.nbc"))))
"""


def test_machine_code_that_can_only_be_read_is_used_and_nothing_is_left_behind(tmp_path: Path) -> None:
    (tmp_path / "small.py").write_text(_READ_ONLY)
    places = {name: tmp_path / name for name in ("code", "temporary")}
    places["temporary"].mkdir()
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(places["code"]), "TMPDIR": str(places["temporary"])}

    def run(how: str) -> tuple[list[str], str]:
        result = subprocess.run(
            [sys.executable, "-c", "import small", how],
            capture_output=True, text=True, timeout=120, env=environment, cwd=tmp_path,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        return result.stdout.split(), result.stderr

    assert run("writable")[0] == ["compiled", "2"]  # and announced
    for data in places["code"].rglob("*.2.nbc"):
        data.unlink()  # one signature's is missing, and compiled in a folder of the process
    before = sorted(places["code"].rglob("*"))
    assert run("read-only") == (["loaded", "2"], "")
    assert sorted(places["code"].rglob("*")) == before
    assert not list(places["temporary"].glob("athrl-compiled-*"))


def test_code_is_taken_from_places_before_the_one_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = Path(folder()).name
    for place, content in (("chosen", "read"), ("home", "own")):
        (tmp_path / place / name / "traffic").mkdir(parents=True)
        for ending in ("nbi", "1.nbc"):
            (tmp_path / place / name / "traffic" / f"tick.{ending}").write_text(content)
    for ending in ("nbi", "1.nbc", "2.nbc"):
        (tmp_path / "chosen" / name / "traffic" / f"flow.{ending}").write_text("read")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(compilation, "_is_writable", lambda place: place == tmp_path / "home" / name)
    for _ in range(2):  # what is there already is left as it is
        assert folder() == str(tmp_path / "home" / name)
    found = {file.name: file.read_text() for file in (tmp_path / "home" / name / "traffic").iterdir()}
    assert found == {
        **{f"tick.{ending}": "own" for ending in ("nbi", "1.nbc")},
        **{f"flow.{ending}": "read" for ending in ("nbi", "1.nbc", "2.nbc")},
    }


def test_the_announcement_names_what_is_compiled_and_how_often(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    def said() -> list[str]:
        caplog.clear()
        with compilation.compiled_once(drive, "some thing", 7):
            pass
        return caplog.messages

    monkeypatch.setattr(compilation, "cache_folder", lambda family: str(tmp_path))
    assert said() == ["compiling some thing: about 7 s, once per installation"]
    monkeypatch.setattr(compilation, "_persistent_folder", lambda family: None)
    assert said() == [
        "compiling some thing: about 7 s, at every start, as no folder to keep it in can be written: "
        "set NUMBA_CACHE_DIR to one"
    ]
    (tmp_path / "drive.drive-1.py311.1.nbi").touch()
    assert said() == []


_WATCH = """
import gc
import gymnasium, highway_env
from numba.core.dispatcher import Dispatcher
import athrl_driving

def known():
    return {
        (kernel.py_func.__module__, kernel.py_func.__qualname__, signature)
        for kernel in gc.get_objects()
        if isinstance(kernel, Dispatcher)
        for signature in kernel.overloads
        if kernel.py_func.__module__.startswith("athrl_")
    }
"""

_FIRST_STEPS = {
    "direct": """
env = gymnasium.make("athrl/Town03-v0", config={"action": {"type": "DirectAction"}})
before = known()
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
    env.unwrapped.scene()
""",
    "towns": """
from athrl_driving.policy import EnvironmentBatch
batch = EnvironmentBatch(["town03", "town02"], {"vehicles_count": 5}, "waypoint-set", recorded=2)
before = known()
for env_index in range(2):
    batch.reset(env_index, seed=env_index)
batch.step([[2, 3], [1, 15]])
""",
    "town": """
env = gymnasium.make("athrl/Town03-v0")
driver = athrl_driving.make_driver("rule-based")
before = known()
env.reset(seed=0)
driver.reset(env, 0)
ended = False
while not ended:
    _, _, terminated, truncated, info = env.step(driver.act(env))
    env.unwrapped.scene()
    ended = terminated or truncated
""",
    "vector": """
envs = gymnasium.make_vec("athrl/Town03-v0", num_envs=8, vectorization_mode="vector_entry_point", threads=2)
before = known()
envs.reset(seed=0)
for _ in range(126):
    infos = envs.step(envs.action_space.sample())[-1]
    assert envs.scene(3)
envs.close()
""",
}


@pytest.mark.parametrize("what", _FIRST_STEPS)
def test_nothing_is_compiled_after_the_environment_is_there(what: str) -> None:
    script = _WATCH + _FIRST_STEPS[what] + "assert before\nprint(sorted(known() - before))"
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"
