"""`athrl evaluate` drives where it is told, says where it drives by itself, and replaces no recording."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from athrl.errors import CommandError
from athrl.evaluate.command import evaluate
from athrl_driving.maps.town import _FOLDER as TOWNS
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_evaluator.recording.reading import read_frames
from athrl_protocol import RunFileError
from athrl_protocol.run_file import read_run_file, saved_toml, with_whole_maps

SHORT = ["environment.vehicles=3", "environment.episode_ticks=8"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("ATHRL_SET", "ATHRL_RUN_FILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scored(capsys: pytest.CaptureFixture[str], **options: Any) -> tuple[dict[str, Any], str]:
    """Evaluate; return what standard output and standard error say."""
    evaluate(**{"policy": "blind", "episodes": 2, "seed": 5, "as_json": True, "settings": SHORT} | options)
    out, err = capsys.readouterr()
    return json.loads(out), err


def run_in(here: Path, town: Path | str) -> Path:
    """The folder of a run with a policy."""
    folder = here / "runs" / "mine"
    (folder / "policies").mkdir(parents=True)
    shutil.copy(shipped_policy("town03"), folder / "policies" / "latest.onnx")
    settings = [f"environment.towns={town}", "environment.vehicles=7", "environment.episode_ticks=8"]
    settings += ["exploration.random_decisions=0", "replay.sequence_length=2"]
    (folder / "run.toml").write_text(saved_toml(with_whole_maps(read_run_file(None, settings))))
    return folder


def test_policy_of_a_run_is_scored_in_the_towns_of_its_run(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(TOWNS / "town02.xodr", here / "m.xodr")
    policy = str(run_in(here, "m.xodr") / "policies" / "latest.onnx")
    facts, said = scored(capsys, policy=policy, settings=None)
    assert facts["town"] == f"{here}/m.xodr"
    assert (
        said == f"athrl: driven in {here}/m.xodr with the settings of the policy's run, runs/mine/run.toml\n"
    )
    facts, said = scored(capsys, policy=policy, settings=None, town=["town02"])
    assert facts["town"] == "town02"
    assert said == "athrl: driven with the settings of the policy's run, runs/mine/run.toml\n"


def test_other_driver_says_in_one_line_that_it_drove_in_the_default_town(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    facts, said = scored(capsys)
    assert facts["town"] == "town03"
    assert said == "athrl: driven in town03, the default: --town names another town or a map\n"
    assert scored(capsys, town=["town03"])[1] == ""
    assert scored(capsys, settings=[*SHORT, "environment.towns=town03"])[1] == ""
    monkeypatch.setenv("ATHRL_SET", "environment.towns=town03")
    assert scored(capsys)[1] == ""


def test_every_town_that_is_named_is_driven_in(capsys: pytest.CaptureFixture[str]) -> None:
    facts, _ = scored(capsys, town=["town02", "random-1"])
    assert [each["town"] for each in facts["towns"]] == ["town02", "random-1"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"town": ["town02", "town02"]}, r'^--town has "town02" twice'),
        ({"town": ["town02", "town3"]}, "^--town town3: there is no town"),
        (
            {"town": ["town02"], "settings": ["environment.vehicles=900"]},
            r"^environment\.vehicles is 900, town02 has room for \d+$",
        ),
        (
            {"case_study": "roundabout", "settings": ["environment.vehicles=9000"]},
            r"^environment\.vehicles is 9000, town03 has room for \d+$",
        ),
    ],
)
def test_what_cannot_be_driven_is_refused_by_the_name_of_the_setting(
    options: dict[str, Any], told: str
) -> None:
    with pytest.raises(CommandError, match=told):
        evaluate(**{"policy": "blind", "episodes": 2} | options)


def test_replaced_map_of_a_run_is_refused_with_its_run_file(here: Path) -> None:
    shutil.copy(TOWNS / "town02.xodr", here / "m.xodr")
    folder = run_in(here, "m.xodr")
    shutil.copy(TOWNS / "town04.xodr", here / "m.xodr")
    for options in ({"town": ["m.xodr"]}, {}):
        with pytest.raises(RunFileError, match=r"m\.xodr is another map than the run's"):
            evaluate(policy="blind", episodes=2, run_file=folder / "run.toml", **options)


def test_recordings_are_replaced_only_if_that_is_asked_for(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings, file = here / "recordings", here / "recordings" / "blind-seed-5.mcap"
    scored(capsys, town=["town02"], record=recordings)
    with pytest.raises(CommandError, match=r"blind-seed-5\.mcap exists already: .* or add --overwrite"):
        scored(capsys, town=["random-1"], record=recordings)
    assert next(read_frames(file)).town == "town02"
    scored(capsys, town=["random-1"], record=recordings, overwrite=True)
    assert next(read_frames(file)).town == "random-1"
    scored(capsys, town=["random-1"], record=recordings, seed=7)


def test_name_of_a_map_is_shown_whole(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    maps = here / "a-folder-with-a-name-that-is-longer-than-many-others-are"
    maps.mkdir()
    for name in ("[bold]x", ":car:"):
        shutil.copy(TOWNS / "town02.xodr", maps / f"{name}.xodr")
    towns = [str(path) for path in sorted(maps.iterdir())]
    for given in (towns, towns[:1], towns[1:]):
        evaluate(policy="blind", episodes=2, settings=SHORT, town=given)
        lines = capsys.readouterr().out.splitlines()
        cells = [
            "".join(column)
            for column in zip(*(line.split("│") for line in lines if "│" in line), strict=True)
        ]
        shown = "".join(cells).replace(" ", "") + "".join(lines).replace(" ", "")
        assert all(town in shown for town in given)
