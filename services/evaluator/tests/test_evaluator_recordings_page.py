"""The page about recordings says what is in one, and its program reads one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from athrl_evaluator.recording.origin import Origin
from athrl_evaluator.recording.reading import read_driven, read_frames
from athrl_evaluator.recording.recorder import Recorder
from athrl_evaluator.scoring.drivers import ReferenceDriver
from athrl_evaluator.scoring.environments import make_batch
from athrl_evaluator.scoring.episodes import drive_episodes
from athrl_protocol import Frame, Point, Vehicle
from athrl_protocol.run_file import EnvironmentSection
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

REFERENCE = Path(__file__).parents[3] / "docs/reference"
PAGE = (REFERENCE / "recordings.md").read_text()
LAYOUT = json.loads((REFERENCE / "foxglove-layout.json").read_text())
SCALAR_TYPES = {"double": 1, "uint64": 4, "fixed64": 6, "string": 9, "bytes": 12, "uint32": 13}


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading, without the table's head."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def form(line: str) -> str:
    """A line with signs instead of its numbers."""
    return re.sub(r"\d+", "0", line)


def names(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of a driver that decides waypoints."""
    folder = tmp_path_factory.mktemp("recordings")
    driver = ReferenceDriver("rule-based", 1)
    batch = make_batch(EnvironmentSection(vehicles=3, episode_ticks=24), 1)
    drive_episodes(driver, batch, [1], [Recorder(driver, folder, episodes=1, kept=None)])
    return folder / "rule-based-seed-1.mcap"


def test_program_of_the_page_reads_a_recording(recording: Path, tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(program.splitlines()) <= 10
    (tmp_path / "read.py").write_text(program)
    result = subprocess.run(
        [sys.executable, "read.py", str(recording)], cwd=tmp_path, capture_output=True, text=True,
        timeout=120, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    frames = list(read_frames(recording))
    assert len(frames) == 6
    told = [line.partition(", decided ")[0] for line in result.stdout.splitlines()]
    assert told == [
        f"{frame.time:.1f} s, {frame.ego.speed:.1f} m/s, reward {frame.reward:.1f}" for frame in frames
    ]
    shown = re.findall(r"^0\.4 s, .*decided", PAGE, re.MULTILINE)
    assert [form(line) for line in shown] == [form(f"{told[0]}, decided")]


def test_page_names_every_topic_with_its_schema(recording: Path) -> None:
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    written = {
        channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()
    }
    assert {names(topic)[0]: names(schema)[0] for topic, schema, _ in rows("Topics")} == written


def test_page_names_every_field_with_its_type() -> None:
    fields = {field.name: field for field in Frame.DESCRIPTOR.fields}
    listed: list[str] = []
    for field_cell, type_cell, _ in rows("`athrl.v4.Frame`"):
        listed += names(field_cell)
        types = type_cell.split(", ") * len(names(field_cell))
        for name, kind in zip(names(field_cell), types, strict=False):
            field = fields[name]
            if kind in SCALAR_TYPES:
                assert (field.type, field.is_repeated) == (SCALAR_TYPES[kind], False), name
            else:
                assert field.message_type is not None
                assert field.is_repeated == kind.startswith(("repeated", "map")), name
                assert kind.startswith("map") or kind.endswith(field.message_type.name), name
    assert sorted(listed) == sorted(fields)
    for message in (Vehicle, Point):
        described = re.search(rf"`{message.DESCRIPTOR.name}` has ([^;]*?)[;.]", PAGE, re.DOTALL)
        assert described
        assert names(described[1]) == [field.name for field in message.DESCRIPTOR.fields]


def test_page_names_every_text_of_the_origin(recording: Path) -> None:
    listed = [name for cell, _ in rows("Origin") for name in names(cell)]
    assert sorted(listed) == sorted(read_driven(recording).origin.metadata())
    assert set(listed) == set(Origin.__dataclass_fields__)


def test_foxgloves_layout_names_topics_and_fields_that_a_recording_has(recording: Path) -> None:
    with recording.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        messages = {channel.topic: message for _, channel, _, message in decoded}
    topics, fields = set[str](), set[str]()
    for config in LAYOUT["configById"].values():
        topics |= set(config.get("topics", {}))
        topics |= {config["imageMode"]["imageTopic"]} if config.get("imageMode") else set()
        fields |= {path["value"] for path in config.get("paths", [])}
        fields |= {config["topicPath"]} if "topicPath" in config else set()
    assert topics | {field.partition(".")[0] for field in fields} == set(messages)
    for field in fields:
        topic, *path = field.split(".")
        value = messages[topic]
        for name in path:
            value = getattr(value, name)


def test_every_panel_of_the_layout_is_shown() -> None:
    def panels(node: str | dict) -> list[str]:
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
