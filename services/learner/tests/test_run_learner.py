"""Whole runs over loopback with an actor that speaks the real protocol: start, end, stop, kill, resume."""

import functools
import json
import logging
import multiprocessing
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import onnx
import pytest
from athrl_learner import (
    CannotResume,
    RunFolderInUse,
    RunFolderTaken,
    Summary,
    check_run,
    publication,
    run_learner,
)
from athrl_learner import learner as learner_module
from athrl_learner.checkpoint import newest_intact_checkpoint
from athrl_learner.errors import TooLittleMemory, WrongPlanner
from athrl_protocol import (
    AddressInUse,
    Phase,
    PolicySubscriber,
    RunFile,
    StateSubscriber,
    announce_presence,
    open_session,
    read_run_file,
    to_toml,
)


@contextmanager
def learner(run_file: RunFile | None, resume: Path | None = None) -> Iterator[tuple[Future, threading.Event]]:
    """A learner in a separate thread; stopped at the latest when the block ends."""
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        try:
            yield pool.submit(run_learner, run_file, resume=resume, stop=stop), stop
        finally:
            stop.set()


def folder_of(run_file: RunFile) -> Path:
    return Path(run_file.run.folder) / run_file.run.name


def test_a_run_ends_by_itself_and_policies_only_grow_newer(run_file, fake_actor):
    with learner(run_file) as (running, _), fake_actor:
        summary: Summary = running.result(timeout=120)
    assert summary.finished
    assert fake_actor.finished
    assert 400 <= summary.environment_steps < 405
    assert summary.environment_steps == 5 * fake_actor.statistics.acknowledged
    # 340 transitions after the warm-up at 4 samples each are 68 updates of 4 x 5, less one that is not full.
    assert 67 <= summary.updates <= 69
    assert summary.samples_per_insert == pytest.approx(4, rel=0.05)

    versions = [policy.version for policy in fake_actor.policies]
    assert versions[0] == 0
    assert versions == sorted(set(versions))
    assert versions[-1] == summary.policy_version > 0
    first, last = fake_actor.policies[0], fake_actor.policies[-1]
    assert (first.uniform_exploration, first.updates) == (True, 0)
    assert (last.uniform_exploration, last.updates) == (False, summary.updates)
    assert last.noise_scale == pytest.approx(0.5)
    assert fake_actor.states[-1].phase is Phase.FINISHED
    assert fake_actor.states[-1].policy_version == summary.policy_version
    names = {name for report in fake_actor.metrics for name in report.values}
    assert {"environment_steps", "replay_fill", "samples_per_insert", "waiting/learner"} <= names

    assert summary.policy.read_bytes() == last.artefact
    onnx.checker.check_model(onnx.load_from_string(last.artefact))
    assert read_run_file(summary.folder / "run.toml") == run_file
    assert newest_intact_checkpoint(summary.folder / "checkpoints") is not None


def test_a_stopped_run_goes_on_where_it_was(run_file, fake_actor):
    with fake_actor:
        with learner(run_file) as (running, stop):
            fake_actor.wait_for(lambda: any(policy.updates for policy in fake_actor.policies))
            stop.set()
            stopped: Summary = running.result(timeout=60)
        assert not stopped.finished
        assert 60 <= stopped.environment_steps < 400
        received = len(fake_actor.policies)
        # The actor stays as it is: it keeps what was not acknowledged and finds the learner again.
        with learner(None, resume=folder_of(run_file)) as (running, _):
            resumed: Summary = running.result(timeout=120)
    assert resumed.finished
    assert fake_actor.finished
    assert fake_actor.policies[received].version > stopped.policy_version
    assert fake_actor.policies[received].updates == stopped.updates
    versions = [policy.version for policy in fake_actor.policies]
    assert versions == sorted(set(versions))
    assert resumed.environment_steps == 5 * fake_actor.statistics.acknowledged
    assert 67 <= resumed.updates <= 69
    draining = [state for state in fake_actor.states if state.phase is Phase.DRAINING]
    assert draining[0].environment_steps == stopped.environment_steps


RUN = """
import threading
from pathlib import Path
from athrl_learner import run_learner
from athrl_protocol import read_run_file
run_file = read_run_file(path)
folder = Path(run_file.run.folder) / run_file.run.name
resume = folder if (folder / "run.toml").exists() else None
run_learner(None if resume else run_file, resume=resume, stop=threading.Event())
"""


@contextmanager
def killed_in_the_end(run_file: RunFile, path: Path) -> Iterator[None]:
    """A learner in a separate process, which resumes an existing run, until it is killed."""
    path.write_text(to_toml(run_file))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["athrl_learner"])  # loaded once, not for each learner
    process = context.Process(target=exec, args=(RUN, {"path": path}))
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()
        process.close()


@pytest.mark.parametrize(("checkpoint_seconds", "fsync"), [(0.2, "acknowledgement"), (1000.0, "never")])
def test_kills_lose_nothing_that_was_acknowledged_and_count_nothing_twice(
    run_file, fake_actor, tmp_path, checkpoint_seconds, fsync
):
    settings = changed(run_file, "learner", checkpoint_seconds=checkpoint_seconds)
    settings = changed(settings, "durability", fsync=fsync)
    with fake_actor:
        for steps in (100, 200):
            with killed_in_the_end(settings, tmp_path / "file.toml"):
                fake_actor.wait_for(
                    lambda steps=steps: fake_actor.states and fake_actor.states[-1].environment_steps >= steps
                )
        with learner(None, resume=folder_of(run_file)) as (running, _):
            resumed: Summary = running.result(timeout=120)
    counts = fake_actor.statistics
    assert resumed.finished
    assert resumed.environment_steps == 5 * counts.acknowledged
    assert counts.produced == counts.acknowledged + counts.given_up + counts.waiting
    last = [report.values for report in fake_actor.metrics if "intake/stored" in report.values][-1]
    assert last["intake/stored"] == counts.acknowledged
    assert last["intake/lost"] == last["intake/refused"] == last["log/damaged"] == 0
    _, checkpoint = newest_intact_checkpoint(resumed.folder / "checkpoints")
    assert checkpoint.state["totals"]["transitions"] == resumed.environment_steps
    assert resumed.samples_per_insert == pytest.approx(4, rel=0.1)


def test_a_damaged_checkpoint_costs_training_but_no_experience(run_file, fake_actor, caplog):
    longer = changed(run_file, "run", environment_steps=1600)  # else a fast machine is done too soon
    with fake_actor:
        with learner(longer) as (running, stop):
            fake_actor.wait_for(lambda: any(state.environment_steps >= 100 for state in fake_actor.states))
            checkpoints = folder_of(run_file) / "checkpoints"
            fake_actor.wait_for(lambda: any(checkpoints.glob("checkpoint-??????")))
            stop.set()
            stopped: Summary = running.result(timeout=60)
        newest = max(checkpoints.glob("checkpoint-??????"))
        (newest / "agent.pt").write_bytes(b"")
        goes_on = changed(run_file, "run", environment_steps=stopped.environment_steps + 100)
        with learner(goes_on, resume=folder_of(run_file)) as (running, _):
            resumed: Summary = running.result(timeout=120)
    assert f"{newest / 'agent.pt'} is damaged" in caplog.text
    assert resumed.finished
    assert resumed.environment_steps == 5 * fake_actor.statistics.acknowledged > stopped.environment_steps


def test_a_killed_run_goes_on_from_its_checkpoint(run_file, fake_actor, tmp_path):
    checkpoints = folder_of(run_file) / "checkpoints"
    with fake_actor:
        with killed_in_the_end(run_file, tmp_path / "file.toml"):
            fake_actor.wait_for(lambda: checkpoints.is_dir() and any(checkpoints.glob("checkpoint-??????")))
        received = len(fake_actor.policies)
        with learner(None, resume=folder_of(run_file)) as (running, _):
            resumed: Summary = running.result(timeout=120)
    assert resumed.finished
    assert fake_actor.finished
    assert resumed.environment_steps == 5 * fake_actor.statistics.acknowledged
    # Versions continue above those that the actor has, although the checkpoint is older than the last one.
    newest_before = max(policy.version for policy in fake_actor.policies[:received])
    assert all(policy.version > newest_before for policy in fake_actor.policies[received:])


def test_a_finished_learner_stays_for_an_evaluator_and_when_resumed_until_one_comes(
    run_file, fake_actor, monkeypatch
):
    short = run_file.model_copy(update={"run": run_file.run.model_copy(update={"environment_steps": 70})})
    with learner(short) as (running, _), fake_actor:
        with (
            open_session(connect=run_file.network.listen, timeout=30) as session,
            announce_presence(session, "small", "evaluator", "evaluator"),
        ):
            fake_actor.wait_for(lambda: fake_actor.finished)
            # Longer than it stays without any service.
            time.sleep(2.5)
            assert not running.done()
            with PolicySubscriber(session, "small") as late:
                assert late.wait(timeout=30).version == fake_actor.policies[-1].version
        first: Summary = running.result(timeout=60)
    monkeypatch.setattr(learner_module, "_SECONDS_FOR_EVALUATOR_TO_COME", 600.0)
    with learner(None, resume=first.folder) as (running, _):
        time.sleep(5.0)  # an evaluator that is started with it is still being loaded
        assert not running.done()
        with (
            open_session(connect=run_file.network.listen, timeout=30) as session,
            announce_presence(session, "small", "evaluator", "evaluator"),
            PolicySubscriber(session, "small") as late,
        ):
            assert late.wait(timeout=30).version >= fake_actor.policies[-1].version
            time.sleep(3.0)  # the learner looks around ten times a second
        running.result(timeout=60)  # the evaluator has come and gone
    monkeypatch.setattr(learner_module, "_SECONDS_FOR_EVALUATOR_TO_COME", 1.0)
    with learner(None, resume=first.folder) as (running, _):  # none comes
        again: Summary = running.result(timeout=60)
    assert first.finished
    assert again.finished
    assert (again.environment_steps, again.updates) == (first.environment_steps, first.updates)


def test_finished_and_compared_run_that_is_brought_up_again_does_nothing_but_say_so(
    run_file, fake_actor, monkeypatch, caplog
):
    monkeypatch.setattr(learner_module, "_ALONE_SECONDS", 0.5)
    with learner(changed(run_file, "run", environment_steps=70)) as (running, _), fake_actor:
        first: Summary = running.result(timeout=60)
    comparison = first.folder / "evaluation.json"
    comparison.write_text(json.dumps({"environment_steps": first.environment_steps}))
    before = {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()}
    caplog.set_level(logging.INFO)
    with (
        learner(None, resume=first.folder) as (running, _),
        open_session(connect=run_file.network.listen, timeout=30) as session,
        StateSubscriber(session, "small") as states,
    ):
        state = states.wait(30)  # who is started with it learns that, too
        again: Summary = running.result(timeout=60)
    assert state is not None
    assert state.phase is Phase.FINISHED
    assert again.finished
    assert (again.environment_steps, again.policy_version) == (first.environment_steps, first.policy_version)
    assert {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()} == before
    assert sum("the run is finished and compared" in message for message in caplog.messages) == 1


def changed(run_file: RunFile, section: str, **values: object) -> RunFile:
    return run_file.model_copy(update={section: getattr(run_file, section).model_copy(update=values)})


def test_run_that_can_start_starts_after_a_check(run_file):
    assert check_run(run_file) == f"run small can start in {folder_of(run_file)}"
    with learner(run_file) as (running, stop), open_session(connect=run_file.network.listen, timeout=30):
        assert not running.done()
        stop.set()
        running.result(timeout=60)
    with pytest.raises(RunFolderTaken):
        check_run(run_file)
    with pytest.raises(TooLittleMemory, match=r"replay\.capacity"):
        check_run(changed(changed(run_file, "run", name="large"), "replay", capacity=2**40))
    assert not folder_of(run_file).with_name("large").exists()


def test_planner_whose_policy_no_actor_accepts_is_refused_before_it_trains(run_file, monkeypatch):
    monkeypatch.setattr(publication, "LARGEST_ARTEFACT", 2**10)
    for attempt in (check_run, functools.partial(run_learner, stop=threading.Event())):
        with pytest.raises(WrongPlanner, match=r"its policy has .* MiB, more than the .* that actors accept"):
            attempt(run_file)
        assert not (folder_of(run_file) / "run.toml").exists()


def test_a_resumed_run_follows_the_settings_it_is_given(run_file, fake_actor, monkeypatch):
    monkeypatch.setattr(learner_module, "_SECONDS_FOR_EVALUATOR_TO_COME", 1.0)
    with fake_actor:
        with learner(run_file) as (running, stop):
            fake_actor.wait_for(lambda: any(policy.updates for policy in fake_actor.policies))
            stop.set()
            stopped: Summary = running.result(timeout=60)
        steps = f"from {stopped.environment_steps} environment steps"
        assert check_run(None, resume=folder_of(run_file)).endswith(steps)
        shorter = changed(run_file, "run", environment_steps=stopped.environment_steps)
        with learner(shorter, resume=folder_of(run_file)) as (running, _):
            resumed: Summary = running.result(timeout=120)
    assert resumed.finished
    assert resumed.environment_steps == stopped.environment_steps
    assert read_run_file(resumed.folder / "run.toml") == shorter


def test_settings_that_the_checkpoint_does_not_fit_change_nothing(run_file, fake_actor):
    with fake_actor, learner(run_file) as (running, stop):
        fake_actor.wait_for(lambda: any(policy.updates for policy in fake_actor.policies))
        stop.set()
        running.result(timeout=60)
    wider = changed(run_file, "planner", hidden_features=24)
    with pytest.raises(CannotResume, match="settings"):
        run_learner(wider, resume=folder_of(run_file), stop=threading.Event())
    assert read_run_file(folder_of(run_file) / "run.toml") == run_file


def test_two_learners_never_write_one_folder(run_file):
    with learner(run_file) as (_, _):
        wait_until_started(run_file)
        elsewhere = run_file.model_copy(
            update={"network": run_file.network.model_copy(update={"listen": "tcp/127.0.0.1:1"})}
        )
        with pytest.raises(RunFolderInUse):
            run_learner(elsewhere, stop=threading.Event())
        with pytest.raises(RunFolderInUse):
            run_learner(None, resume=folder_of(run_file), stop=threading.Event())


def test_an_address_in_use_leaves_nothing_behind(run_file):
    with learner(run_file) as (_, _):
        wait_until_started(run_file)
        other = run_file.model_copy(update={"run": run_file.run.model_copy(update={"name": "other"})})
        with pytest.raises(AddressInUse):
            run_learner(other, stop=threading.Event())
    assert not (folder_of(other) / "run.toml").exists()


def test_a_new_run_never_takes_the_folder_of_another(run_file):
    folder_of(run_file).mkdir()
    (folder_of(run_file) / "run.toml").write_text("")
    with pytest.raises(RunFolderTaken, match="--resume"):
        run_learner(run_file, stop=threading.Event())


def test_nothing_cannot_be_resumed(run_file, tmp_path):
    with pytest.raises(CannotResume, match=r"no run\.toml"):
        run_learner(None, resume=tmp_path / "nothing", stop=threading.Event())


def test_a_stop_before_any_experience_leaves_a_run_to_resume(run_file):
    stop = threading.Event()
    stop.set()
    summary = run_learner(run_file, stop=stop)
    assert not summary.finished
    assert summary.policy_version == 0
    again = run_learner(None, resume=summary.folder, stop=stop)
    assert again.policy_version == 1


def wait_until_started(run_file: RunFile) -> None:
    policy = folder_of(run_file) / "policies" / "latest.onnx"
    deadline = time.monotonic() + 150
    while not policy.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
