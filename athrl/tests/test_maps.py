"""`athrl maps check` tells in a report, or in one line, whether a map can be used."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from athrl.maps.report import plain, table
from athrl_driving.inspection import facts_of, suggested_vehicles
from athrl_driving.inspection.trial import Trial
from athrl_driving.maps import TOWNS, load_town
from athrl_spaces import RANDOM_TOWNS


def athrl(*words: str) -> subprocess.CompletedProcess[str]:
    """Run the command; the limit is for a machine that has to compile first."""
    command = [sys.executable, "-m", "athrl", "maps", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


def rows(trial: Trial | None) -> str:
    facts = facts_of(load_town("town04"))
    columns = table(facts, 10, trial, None).columns
    return "\n".join(
        f"{name}: {line}" for name, line in zip(*(column.cells for column in columns), strict=True)
    )


def test_towns_are_listed_with_a_line_each() -> None:
    lines = athrl().stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == [*TOWNS, RANDOM_TOWNS]
    assert "8 junctions: 8 of 3 arms; dense traffic: 64 vehicles" in lines[0]


def test_towns_are_listed_as_one_json_object() -> None:
    found = json.loads(athrl("--json").stdout)
    assert [town["name"] for town in found["towns"]] == list(TOWNS)
    assert found["random_towns"] == RANDOM_TOWNS


def test_map_is_checked_drawn_and_driven(tmp_path: Path) -> None:
    picture = tmp_path / "town02.png"
    found = athrl("check", "town02", "--picture", str(picture), "--vehicles", "20", "--json")
    assert found.returncode == 0, found.stderr
    report = json.loads(found.stdout)
    town = load_town("town02")
    expected = json.loads(json.dumps(plain(facts_of(town), suggested_vehicles(town), None, picture)))
    assert report["trial"]["vehicles"] == 20
    assert {**report, "trial": None} == expected
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["broken.xodr"], "broken.xodr: line 1: the root is <town>, it must be <OpenDRIVE>"),
        (["gone.xodr"], "gone.xodr: there is no such file"),
        (["town1"], "there is no town named 'town1'"),
        (["town02", "--picture", "town02.jpg"], "--picture town02.jpg: its name should end in .png"),
        (["town02", "--picture", "gone/town02.png"], "--picture gone/town02.png: there is no folder"),
        (["town02", "--vehicles", "159"], "--vehicles 159: town02 has room for 158 at most"),
        (["town02", "--vehicles", "0"], "--vehicles"),
        ([], "FILE"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.xodr").write_text("<town/>")
    found = athrl("check", *words)
    assert found.returncode == 2
    assert found.stdout == ""
    (line,) = found.stderr.splitlines()
    assert line.startswith("athrl: ")
    assert told in line


def test_strict_check_refuses_a_file_with_a_small_fault(tmp_path: Path) -> None:
    """A ring whose end misses its start by 2 cm."""
    length = 2.0 * math.pi * 50.0 - 0.02
    path = tmp_path / "ring.xodr"
    path.write_text(
        f'''<OpenDRIVE><header revMajor="1" revMinor="6"/><road id="1" length="{length}" junction="-1"><link>
        <predecessor elementType="road" elementId="1" contactPoint="end"/>
        <successor elementType="road" elementId="1" contactPoint="start"/></link>
        <planView><geometry s="0" x="0" y="0" hdg="0" length="{length}"><arc curvature="0.02"/></geometry>
        </planView><lanes><laneSection s="0"><right><lane id="-1" type="driving">
        <link><predecessor id="-1"/><successor id="-1"/></link><width sOffset="0" a="3" b="0" c="0" d="0"/>
        </lane></right></laneSection></lanes></road></OpenDRIVE>'''
    )
    found = athrl("check", str(path), "--strict", "--no-drive")
    assert (found.returncode, found.stdout) == (2, "")
    (line,) = found.stderr.splitlines()
    assert all(told in line for told in ("ring.xodr", "road 1", "0.021 m"))


def test_report_warns_of_traffic_that_does_not_flow() -> None:
    trial = Trial(
        vehicles=5, seconds=60.0, mean_speed=0.5, share_of_free_flow=0.06, standing=0.9, overlap_seconds=1.5,
        stuck=1, patience=30.0,
    )  # fmt: skip
    report = rows(trial)
    assert "warning: deadlock: at the end 1 vehicle had been standing for more than 30 s" in report
    assert "warning: vehicles collide: pairs of them overlap for 1.5 s" in report
    assert "warning: traffic crawls" in report


def test_report_without_a_trial_tells_what_the_file_holds() -> None:
    report = rows(None)
    assert "file: OpenDRIVE 1.6, 318 roads" in report
    assert "traffic lights: 10 in the file, heeded by 10 lanes in 6 groups that change together" in report
    assert "left out: nothing" in report
    assert "warning" not in report
    assert "trial" not in report
