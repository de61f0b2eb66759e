"""Wrong inputs end in one line that says what to do, an exit code that is not 0, and soon."""

import json
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.forked_command import ForkedCommand, ForkingServer, forking_server

# Without a port to serve, watching asks for a screen first, which a machine of tests may lack.
CLIENTS = [["actor"], ["evaluator"], ["status"], ["watch", "--serve", "9877"]]
SECONDS = 200.0
"""Limit on a busy machine; on an idle one each takes two or three seconds."""

LOADED = (
    "athrl.evaluate.command",
    "athrl.record",
    "athrl.services",
    "athrl.status",
    "athrl.train.command",
    "athrl.watch",
    "athrl_driving.maps",
    "athrl_driving.traffic",
    "athrl_evaluator.scorer",
    "athrl_evaluator.watching.viewer",
    "athrl_learner.run_settings",
)
"""What the commands load before they refuse something."""

LOADED_WITH_TORCH = ("athrl_learner.run", "athrl.serial.session")


@pytest.fixture(scope="module")
def server(shared_command) -> Iterator[ForkingServer]:
    with forking_server(LOADED, shared_command.environment()) as server:
        yield server


@pytest.fixture
def forked(command, server: ForkingServer) -> ForkedCommand:
    """The command without loading it anew; some tests have `command` instead, so that nothing hides here."""
    return ForkedCommand(command, server)


@pytest.fixture(scope="module")
def server_with_torch(shared_command) -> Iterator[ForkingServer]:
    with forking_server((*LOADED, *LOADED_WITH_TORCH), shared_command.environment()) as server:
        yield server


@pytest.fixture
def forked_with_torch(command, server_with_torch: ForkingServer) -> ForkedCommand:
    """The same for what is refused when torch has been loaded."""
    return ForkedCommand(command, server_with_torch)


def assert_one_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    lines = result.stderr.splitlines()
    assert result.returncode not in (0, None)
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("athrl: ")
    for word in words:
        assert word in lines[0], lines[0]


def assert_last_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    """For a command that prints other lines before the error."""
    last = result.stderr.splitlines()[-1]
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert last.startswith("athrl: ")
    for word in words:
        assert word in last, result.stderr


def test_unknown_key_is_named_and_the_near_one_suggested(forked, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[learner]\nbatsch = 3\n")
    result = forked.run("train", "--run-file", "my.toml", seconds=SECONDS)
    assert_one_line(result, "learner.batsch", "batch")


def test_unknown_override_is_named(command) -> None:
    assert_one_line(command.run("train", "--set", "learner.bach=3", seconds=SECONDS), "learner.bach", "batch")


def test_port_for_viewers_of_a_serial_run_is_refused(forked) -> None:
    result = forked.run("train", "--serial", "--viewer-port", "9999", seconds=SECONDS)
    assert_one_line(result, "a serial run streams nothing to viewers", "leave --viewer-port out")


def test_wrong_value_is_named_with_what_is_expected(forked) -> None:
    assert_one_line(
        forked.run("train", "--set", "learner.batch=none", seconds=SECONDS), "learner.batch", "none"
    )


@pytest.mark.parametrize("service", ["train", "learner"])
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (["planner.kind=hdpg"], ["--set planner.kind=hdpg", "did you mean hddpg?"]),
        (
            ["planner.kind=ddpg", "planner.intention_noise=0.3"],
            ["planner.intention_noise", '"athrl"', '"ddpg"'],
        ),
        (["planner.hidden_featurs=64"], ["planner.hidden_featurs", "did you mean planner.hidden_features?"]),
    ],
)
def test_planner_or_setting_of_one_that_does_not_exist_is_named_before_anything_is_written(
    forked, service: str, settings: list[str], told: list[str]
) -> None:
    sets = [word for setting in settings for word in ("--set", setting)]
    result = forked.run(service, *sets, seconds=SECONDS)
    assert_one_line(result, *told)
    assert result.returncode == 2
    assert not list(forked.folder.iterdir())


@pytest.mark.parametrize("words", [["train"], ["evaluate", "--policy", "blind", "--episodes", "2"]])
def test_map_that_is_none_is_named_with_its_line(forked, tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "mine.xodr").write_text("<town/>")
    result = forked.run(*words, "--set", "environment.towns=mine.xodr", seconds=SECONDS)
    assert_one_line(result, "mine.xodr", "line 1", "OpenDRIVE")
    result = forked.run(*words, "--set", "environment.towns=gone.xodr", seconds=SECONDS)
    assert_one_line(result, "gone.xodr", "no such file")


def test_unknown_town_is_named_by_the_option_that_gave_it(forked) -> None:
    words = ["evaluate", "--policy", "blind", "--episodes", "2", "--town", "town3"]
    result = forked.run(*words, seconds=SECONDS)
    assert_one_line(result, "--town town3", "did you mean 'town03'", "town02, town03, town04")
    assert "--set" not in result.stderr


@pytest.mark.parametrize("words", [["train"], ["evaluate", "--policy", "blind", "--episodes", "2"]])
def test_more_vehicles_than_the_town_has_room_for_are_refused(forked, words: list[str]) -> None:
    settings = ["--set", "environment.towns=town02", "--set", "environment.vehicles=1000"]
    assert_one_line(forked.run(*words, *settings, seconds=SECONDS), "1000", "room for")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--set learner.batch=4", "--set learner.batch: evaluate only drives"),
        ("--set run.seed=4", "--set run.seed: evaluate only drives"),
        ("--set evaluator.recordings_kept=4", "--set evaluator.recordings_kept: evaluate only drives"),
        ("--set evaluator.seed=4 --seed 5", "--set evaluator.seed and --seed say the same"),
        ("--set environment.towns=town02 --town town04", "--set environment.towns and --town say the same"),
        ("--case-study rondabout", "it should be roundabout, oncoming-traffic, unprotected-left or all"),
        ("--case-study all --town town02", "--town cannot be used with --case-study"),
        ("--case-study all --set environment.towns=town02", "--set environment.towns cannot be used with"),
    ],
)
def test_evaluate_refuses_what_it_would_ignore(forked, words: str, told: str) -> None:
    given = ["evaluate", "--policy", "blind", "--episodes", "2", *words.split()]
    assert_one_line(forked.run(*given, seconds=SECONDS), told)


def test_evaluate_takes_its_episodes_and_seed_from_the_settings_too(forked) -> None:
    few = ["--set", "environment.episode_ticks=8", "--set", "environment.vehicles=0", "--json"]
    by_option = ["--episodes", "3", "--seed", "6"]
    by_setting = ["--set", "evaluator.final_episodes=3", "--set", "evaluator.seed=6"]
    first, second = (
        forked.run("evaluate", "--policy", "random", *few, *words, seconds=SECONDS)
        for words in (by_option, by_setting)
    )
    assert first.returncode == 0, first.stderr
    assert first.stdout == second.stdout
    facts = json.loads(first.stdout)
    assert (facts["episodes"], facts["seed"]) == (3, 6)


def test_missing_run_file_is_named(forked) -> None:
    assert_one_line(forked.run("train", "--run-file", "nowhere.toml", seconds=SECONDS), "nowhere.toml")


def test_policy_file_that_is_none_is_named(command, tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"not a policy at all")
    result = command.run("evaluate", "--policy", "policy.onnx", "--episodes", "2", "--json", seconds=SECONDS)
    assert_one_line(result, "policy.onnx")
    assert result.stdout == ""


def test_policy_file_that_is_missing_is_named(forked) -> None:
    result = forked.run("evaluate", "--policy", "gone.onnx", "--episodes", "2", "--json", seconds=SECONDS)
    assert_one_line(result, "gone.onnx", "random")


@pytest.mark.parametrize("folder", ["README.md", "README.md/x", "/proc/nope"])
def test_folder_for_recordings_that_cannot_be_made_is_named(forked, folder: str) -> None:
    (forked.folder / "README.md").write_text("no folder")
    words = ["--policy", "blind", "--episodes", "2", "--record", folder]
    result = forked.run("evaluate", *words, seconds=SECONDS)
    assert_one_line(result, f"--record {folder}: ", "a folder that can be made and written")


def test_wrong_option_is_named(command) -> None:
    for words in (["evaluate"], ["evaluate", "--policy", "random", "--episodes", "1"], ["train", "--bogus"]):
        assert_one_line(command.run(*words, seconds=SECONDS), "--", f"athrl {words[0]} --help")


def test_role_that_is_none_is_named_before_a_run_is_looked_for(forked) -> None:
    result = forked.run("status", "--check", "nurse/one", seconds=SECONDS)
    assert_one_line(result, "--check nurse/one", "it should be learner, actor, evaluator, router")


def test_recording_that_is_none_is_named(forked) -> None:
    assert_one_line(forked.run("watch", "gone.mcap", seconds=SECONDS), "gone.mcap")


def test_run_that_cannot_be_resumed_is_named(forked) -> None:
    assert_one_line(forked.run("train", "--resume", "yesterday", seconds=SECONDS), "yesterday")


def test_run_that_is_finished_is_named_with_what_makes_it_longer(forked) -> None:
    folder = forked.folder / "runs" / "done"
    folder.mkdir(parents=True)
    settings = forked.run("run-file", seconds=SECONDS).stdout
    (folder / "run.toml").write_text(settings)
    (folder / "evaluation.json").write_text('{"environment_steps": 600001}')
    result = forked.run("train", "--resume", "done", seconds=SECONDS)
    assert (result.returncode, result.stdout, result.stderr.count("\n")) == (0, "", 1)
    for part in ("runs/done is finished", "600001 of 600000", "--set run.environment_steps=1200000"):
        assert part in result.stderr


def test_port_in_use_is_named(command, forked_with_torch, tiny: list[str], port: int) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        assert_one_line(command.run("train", *tiny, seconds=SECONDS), str(port))
        assert_one_line(forked_with_torch.run("learner", *tiny, seconds=SECONDS), str(port))


@pytest.mark.parametrize("words", [["learner"], ["train"], ["train", "--serial"]])
def test_gpu_that_is_not_there_is_named_before_anything_is_written(
    forked_with_torch, monkeypatch, tiny: list[str], words: list[str]
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    result = forked_with_torch.run(*words, *tiny, "--set", "learner.device=cuda", seconds=SECONDS)
    assert_last_line(result, "learner.device is cuda", "learner.device to auto or cpu")
    assert not list(forked_with_torch.folder.rglob("run.toml"))
    assert not list(forked_with_torch.folder.rglob("checkpoints"))


@pytest.mark.parametrize("words", [["learner"], ["train"], ["train", "--serial"]])
def test_replay_beyond_the_machines_memory_is_refused_once_and_before_anything_is_written(
    forked_with_torch, tiny: list[str], words: list[str]
) -> None:
    result = forked_with_torch.run(*words, *tiny, "--set", "replay.capacity=100000000000", seconds=SECONDS)
    assert_last_line(result, "replay.capacity is 100000000000", "GiB of memory", "set it to less")
    assert "restarting it" not in result.stdout
    assert not list(forked_with_torch.folder.rglob("run.toml"))
    assert not list(forked_with_torch.folder.rglob("checkpoints"))


def test_learner_that_never_comes_is_named(command, port: int) -> None:
    arguments = ["--connect", f"tcp/127.0.0.1:{port}", "--run", "town03"]
    for result in command.run_together([[*client, *arguments] for client in CLIENTS], seconds=SECONDS):
        assert_one_line(result, str(port), "--connect")


def test_run_that_does_not_exist_is_named_with_those_that_do(
    command, seen, tiny: list[str], port: int
) -> None:
    learner = command.start("learner", *tiny, "--set", "run.name=mine")
    where = ["--connect", f"tcp/127.0.0.1:{port}"]
    seen(where[1], "mine", lambda run: True, SECONDS)  # it is served
    calls = [[*client, *where, "--run", "nowhere"] for client in CLIENTS]
    for result in command.run_together(calls, seconds=SECONDS):
        assert_one_line(result, "'nowhere'", "mine")
    assert learner.poll() is None
    learner.terminate()
    learner.wait(timeout=SECONDS)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("train --actors 0", "--actors 0: should be an integer, >= 1 (Number of actors"),
        ("watch --serve 70000", "--serve 70000: should be an integer, <= 65535"),
        ("record blind --video a.mp4 --seconds x", "--seconds x: should be a number (Length of the video)"),
        ("record blind --video a.mp4 --seconds 0", "--seconds 0: should be a number, >= 1 (Length"),
        ("train --actor 3", "there is no option --actor; did you mean --actors?"),
    ],
)
def test_option_that_cannot_be_is_named_with_what_it_should_be(forked, words: str, told: str) -> None:
    result = forked.run(*words.split(), seconds=SECONDS)
    assert_one_line(result, told, f"see athrl {words.split()[0]} --help")
    assert result.returncode == 2


def test_watching_a_file_that_is_no_recording_is_refused_at_once(forked, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no episode")
    assert_one_line(forked.run("watch", "notes.txt", seconds=SECONDS), "notes.txt", ".mcap")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--page", "9000"], ("--page", "--browser")),
        (["--bind", "0.0.0.0"], ("--bind 0.0.0.0", "--serve", "--browser")),
        (["--browser", "--page", "9000", "--serve", "9000"], ("--serve 9000", "--page")),
        (["--browser", "--bind", "0.0.0.0"], ("--bind 0.0.0.0", "password", "ssh")),
        (["--browser", "--save", "seen.rrd"], ("--browser", "--save")),
    ],
)
def test_page_that_cannot_be_served_is_told_why(forked, options: list[str], words: tuple[str, ...]) -> None:
    result = forked.run("watch", "--policy", "blind", *options, seconds=SECONDS)
    assert_one_line(result, *words)


@pytest.mark.parametrize("words", [["watch", "--policy", "blind"], ["record", "blind", "--video", "a.mp4"]])
def test_more_vehicles_than_a_town_has_room_for_are_refused_by_the_option(forked, words: list[str]) -> None:
    result = forked.run(*words, "--town", "town02", "--vehicles", "9999", seconds=SECONDS)
    assert_one_line(result, "--vehicles 9999", "town02 has room for")


def test_command_alone_shows_its_help_and_nothing_after_it(command) -> None:
    result = command.run(seconds=SECONDS)
    assert result.returncode == 2
    assert "train" in result.stdout
    assert result.stderr == ""
