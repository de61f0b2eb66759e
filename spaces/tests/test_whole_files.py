"""A file is there whole or not at all, whatever happens while it is written."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest
from athrl_spaces.whole_files import write_whole


def test_file_is_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "facts.json"
    for content in (b"first", b"second"):
        write_whole(path, content)
        assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_key_is_never_readable_by_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modes = []
    replace = Path.replace

    def seen(part: Path, path: Path) -> Path:
        modes.append(stat.S_IMODE(part.stat().st_mode))
        return replace(part, path)

    monkeypatch.setattr(Path, "replace", seen)
    write_whole(tmp_path / "key.pem", b"secret", mode=0o600)
    assert modes == [0o600]
    assert stat.S_IMODE((tmp_path / "key.pem").stat().st_mode) == 0o600


def test_full_disk_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "facts.json"
    write_whole(path, b"first")

    def full(_: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"second")
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: sizes.append(os.fstat(descriptor).st_size))
    write_whole(tmp_path / "facts.json", b"x" * 100)
    assert sizes == [100]


def test_what_a_killed_process_left_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / f"facts.json.{os.getpid()}.part").write_bytes(b"half")
    write_whole(tmp_path / "facts.json", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["facts.json"]


def test_reader_sees_whole_files_only(tmp_path: Path) -> None:
    path, done = tmp_path / "facts.json", threading.Event()
    contents = {bytes([value]) * 100_000 for value in (1, 2)}
    write_whole(path, min(contents))

    def write() -> None:
        for _ in range(30):
            for content in contents:
                write_whole(path, content)
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not done.is_set():
        assert path.read_bytes() in contents
    writer.join()
