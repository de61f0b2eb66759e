"""Settings that change when a run is resumed are told, kept in the run's folder and served."""

import json
import logging
import os
import threading

import pytest
from athrl_learner import run_learner
from athrl_learner.errors import LearnerError
from athrl_learner.run_changes import replace_settings
from athrl_learner.run_folder import RunFolder
from athrl_protocol import RunFile, open_session, read_run_file, to_toml
from athrl_protocol.announcements.answers import fetch_changes


@pytest.fixture(autouse=True)
def _log_everything(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)


def changed(run_file: RunFile, section: str, **values: object) -> RunFile:
    table = getattr(run_file, section).model_copy(update=values)
    return run_file.model_copy(update={section: table})


def test_each_change_is_one_line_with_both_values_and_all_changes_stay(tmp_path, run_file, caplog):
    with RunFolder(tmp_path / "small") as folder:
        assert replace_settings(folder, run_file, 0) == []
        assert replace_settings(folder, run_file, 100) == []
        longer = changed(run_file, "run", environment_steps=900)
        assert "setting" not in caplog.text
        first = ["run.environment_steps was 400 and is 900, from step 200"]
        assert replace_settings(folder, longer, 200) == first
        both = changed(changed(longer, "learner", batch=40), "exploration", random_decisions=70)
        assert replace_settings(folder, both, 300) == [
            *first,
            "exploration.random_decisions was 60 and is 70, from step 300",
            "learner.batch was 20 and is 40, from step 300",
        ]
        assert replace_settings(folder, both, 350) == replace_settings(folder, both, 400)
        assert read_run_file(folder.run_toml, complete=True) == both
    lines = [message for message in caplog.messages if message.startswith("setting ")]
    assert len(lines) == 3
    kept = [json.loads(line) for line in (tmp_path / "small" / "changes.jsonl").read_text().splitlines()]
    assert [change["setting"] for change in kept] == [line.split()[1] for line in lines]


def test_folder_that_was_moved_is_no_change(tmp_path, run_file):
    with RunFolder(tmp_path / "small") as folder:
        replace_settings(folder, run_file, 0)
        assert replace_settings(folder, changed(run_file, "run", folder="/elsewhere"), 5) == []


def test_settings_that_are_new_are_one_line_together(tmp_path, run_file, caplog):
    with RunFolder(tmp_path / "small") as folder:
        lines = to_toml(run_file).splitlines()
        older = [line for line in lines if not line.startswith(("burn_in", "checkpoints_kept"))]
        folder.run_toml.write_text("\n".join(older))
        settings = read_run_file(folder.run_toml, complete=True)
        assert replace_settings(folder, settings, 0) == []
    (line,) = [message for message in caplog.messages if "earlier release" in message]
    assert line.endswith("settings that are new: replay.burn_in = 0, learner.checkpoints_kept = 3")


def test_damaged_line_of_the_history_is_left_out(tmp_path, run_file):
    with RunFolder(tmp_path / "small") as folder:
        replace_settings(folder, run_file, 0)
        replace_settings(folder, changed(run_file, "run", seed=9), 1)
        path = folder.path / "changes.jsonl"
        path.write_bytes(b'{"setting": 3}\n\xff'[:-1] + b"[]\n" + path.read_bytes())
        assert len(replace_settings(folder, changed(run_file, "run", seed=8), 2)) == 2


def test_resumed_learner_serves_its_changes(run_file, address):
    stop = threading.Event()
    stop.set()
    folder = run_learner(run_file, stop=stop).folder
    stop.clear()
    longer = changed(run_file, "run", environment_steps=900)
    learner = threading.Thread(target=run_learner, args=(longer,), kwargs={"resume": folder, "stop": stop})
    learner.start()
    try:
        with open_session(connect=longer.network.listen, timeout=60) as session:
            told: list[str] = []
            while not told and learner.is_alive():
                told = fetch_changes(session, "small")
    finally:
        stop.set()
        learner.join(60)
    assert told == ["run.environment_steps was 400 and is 900, from step 0"]


def test_lines_that_are_no_change_are_left_out_and_a_pipe_is_named(tmp_path, run_file, caplog):
    whole = {"setting": "learner.batch", "was": 64, "now": 20, "environment_steps": 5}
    wrong = [
        b"[" * 50_000,
        b"\xff",
        b"{}",
        json.dumps({**whole, "setting": "\x1b[2J"}).encode(),
        b"1" * 5_001,
    ]
    with RunFolder(tmp_path / "small") as folder:
        path = folder.path / "changes.jsonl"
        path.write_bytes(b"\n".join([*wrong, json.dumps(whole).encode()]))
        assert replace_settings(folder, run_file, 0) == ["learner.batch was 64 and is 20, from step 5"]
        assert caplog.text.count("has a line that is no change") == len(wrong)
        path.unlink()
        os.mkfifo(path)
        with pytest.raises(
            LearnerError, match=rf"^{path} is a pipe, socket or device, should be a file; move"
        ):
            replace_settings(folder, run_file, 0)


def test_run_with_certificates_goes_on_without_them_only_on_this_machine(run_file, free_address):
    stop = threading.Event()
    stop.set()
    folder = run_learner(run_file, stop=stop).folder
    guarded = changed(run_file, "network", listen="tls/0.0.0.0:7447")
    (folder / "run.toml").write_text(to_toml(guarded))
    for listen in ("tls/0.0.0.0:7447", "tcp/0.0.0.0:7447"):
        with pytest.raises(Exception, match=r"tls/0\.0\.0\.0:7447 needs certificates"):
            run_learner(changed(guarded, "network", listen=listen), resume=folder, stop=stop)
    here = changed(guarded, "network", listen=free_address())
    assert run_learner(here, resume=folder, stop=stop).folder == folder
    assert read_run_file(folder / "run.toml", complete=True).network.listen == here.network.listen
