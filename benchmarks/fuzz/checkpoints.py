"""Checkpoints: manifest, state and tensors, each with checksums that fit, so that its own parser sees it."""

from __future__ import annotations

import hashlib
import io
import json
import random
import zipfile
from pathlib import Path
from typing import Any

import torch
from athrl_learner.checkpoint.content import AGENT, MANIFEST, STATE, manifest_checksum
from athrl_learner.errors import LearnerError

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser
from benchmarks.fuzz.small_run import SmallRun


def manifest(folder: Path) -> Parser:
    """Return the parser of a manifest."""
    run = SmallRun(folder)
    path = run.checkpoint / MANIFEST

    def sealed(chance: random.Random, content: bytes) -> bytes:
        values = mutations.changed_document(chance, json.loads(content))
        values["sha256"] = manifest_checksum(values)
        return json.dumps(values).encode()

    def read(path: Path) -> None:
        run.repair()
        run.resume()

    ways = [*mutations.TEXT, *3 * [sealed]]
    return file_parser([path.read_bytes()], ways, path, read, LearnerError)


def state(folder: Path) -> Parser:
    """Return the parser of a learner's state."""
    return _part(folder, STATE, [*mutations.TEXT, *4 * [mutations.changed_json]])


def agent(folder: Path) -> Parser:
    """Return the parser of tensors."""
    ways = [*mutations.BYTES, _changed_entries, _changed_entries, _other_tensors, _other_tensors]
    return _part(folder, AGENT, ways)


def _part(folder: Path, name: str, ways: list[Any]) -> Parser:
    """Return the parser of a file of a checkpoint, in whose manifest its checksum is always right."""
    run = SmallRun(folder)
    manifest_path = run.checkpoint / MANIFEST
    values = json.loads(manifest_path.read_bytes())

    def read(path: Path) -> None:
        values["files"][name]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        values["sha256"] = manifest_checksum(values)
        manifest_path.write_text(json.dumps(values))
        run.resume()

    path = run.checkpoint / name
    return file_parser([path.read_bytes()], ways, path, read, LearnerError)


def _changed_entries(chance: random.Random, content: bytes) -> bytes:
    """Return the archive with another entry: damaged, compressed, large, missing or twice."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        entries = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    place = chance.randrange(len(entries))
    name, held = entries[place]
    match chance.randrange(5):
        case 0:
            entries[place] = (name, chance.choice(mutations.BYTES)(chance, held))
        case 1:
            del entries[place]
        case 2:
            entries.append((chance.choice([name, "../outside", "archive/data/99", "data.pkl"]), held))
        case 3:
            entries[place] = (name, bytes(chance.choice([0, 1, 10**6])))
        case _:
            entries[place] = (name, mutations.changed_bytes(chance, held))
    compression = chance.choice([zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    changed = io.BytesIO()
    with zipfile.ZipFile(changed, "w", compression) as archive:
        for name, held in entries:
            archive.writestr(name, held)
    return changed.getvalue()


def _other_tensors(chance: random.Random, content: bytes) -> bytes:
    """Return an archive of something else that torch writes."""
    own: list[Any] = []
    for _ in range(60):
        own = [own, own]
    deep: list[Any] = []
    for _ in range(200):
        deep = [deep]
    value = chance.choice(
        [
            own,
            deep,
            None,
            10**400,
            float("nan"),
            torch.zeros(1).expand(2**40),
            torch.zeros(3).to_sparse(),
            torch.zeros(0),
            torch.empty(2**40, device="meta"),
            {1: 2, "x": {3}},
            Path("/etc"),
        ]
    )
    place = chance.choice(
        [{"planner": value, "priorities": {}}, {"planner": {"networks": value}, "priorities": {}}, value]
    )
    saved = io.BytesIO()
    torch.save(place, saved, _use_new_zipfile_serialization=chance.random() < 0.9)
    return saved.getvalue()
