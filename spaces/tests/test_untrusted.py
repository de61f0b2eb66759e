"""A file from elsewhere is read within its bound, and what its parser raises becomes one line of ours."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from athrl_spaces.untrusted import (
    LONGEST_REASON,
    MOST_JSON_BYTES,
    UntrustedFile,
    parser_errors,
    read_json,
    read_untrusted,
)


class Broken(Exception):  # noqa: N818
    """The error of some file."""


class LibraryError(Exception):
    """An error of a library that is none of Python's own."""


def test_file_within_its_bound_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_untrusted(path, 5) == b"12345"
    status = Path("/proc/self/stat")  # whose size is 0
    assert status.stat().st_size == 0
    assert len(read_untrusted(status, 10_000)) > 50
    with pytest.raises(UntrustedFile, match="is too large"):
        read_untrusted(status, 50)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: path.write_bytes(b"123456"), "is too large: should have at most 5 bytes"),
        (lambda path: path.mkdir(), "is a folder, should be a file"),
        (os.mkfifo, "is a pipe, socket or device, should be a file"),
        (lambda path: path.symlink_to("/dev/zero"), "is a pipe, socket or device, should be a file"),
        (lambda path: path.symlink_to(path), "cannot be read: too many levels of symbolic links"),
        (lambda path: None, "cannot be read: no such file or directory"),
    ],
    ids=["large", "folder", "pipe", "device", "circle", "missing"],
)
def test_what_is_no_file_within_its_bound_is_refused_without_a_wait(
    make: Callable[[Path], object], reason: str, tmp_path: Path
) -> None:
    make(tmp_path / "file")
    with pytest.raises(UntrustedFile) as caught:
        read_untrusted(tmp_path / "file", 5)
    assert str(caught.value) == reason


@pytest.mark.parametrize("content", [b"{", b"[" * 100_000, b"\xff", b" " * (MOST_JSON_BYTES + 1)])
def test_json_that_is_none_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "facts.json"
    path.write_bytes(b'{"version": 3}')
    assert read_json(path) == {"version": 3}
    path.write_bytes(content)
    with pytest.raises(UntrustedFile):
        read_json(path)


@pytest.mark.parametrize("name", ["a\0b", "a\udfffb", "a" * 5_000])
def test_name_that_no_file_can_have_is_refused(name: str) -> None:
    with pytest.raises(UntrustedFile, match=r"^cannot be read: "):
        read_untrusted(name, 5)


@pytest.mark.parametrize(
    ("parse", "reason"),
    [
        (lambda: json.loads("[" * 100_000), "is nested too deeply"),
        (lambda: json.loads("1" * 5_001), "has a number of thousands of digits"),
        (lambda: json.loads(b'"\xff"'), "is not UTF-8 text"),
        (lambda: json.loads("{"), "Expecting property name"),
        (lambda: json.loads("{}")["sha256"], "lacks 'sha256'"),
        (lambda: json.loads("[]").keys(), "has no attribute"),
        (lambda: int(json.loads("1e400")), "has a number that is out of range"),
        (lambda: np.empty(2**50), "announces more data than fits into memory"),
        (lambda: struct.unpack("<Q", b"123"), "requires a buffer of 8 bytes"),
    ],
)
def test_error_of_a_parser_becomes_ours(parse: Callable[[], object], reason: str) -> None:
    with pytest.raises(Broken, match=reason) as caught, parser_errors(Broken):
        parse()
    assert caught.value.__cause__ is None


def test_error_of_a_library_becomes_ours_if_it_is_named() -> None:
    with pytest.raises(Broken, match="of the library"), parser_errors(Broken, LibraryError):
        raise LibraryError("of the library")
    with pytest.raises(LibraryError), parser_errors(Broken):
        raise LibraryError("of the library")


def test_reason_is_one_short_printable_line() -> None:
    with pytest.raises(Broken) as caught, parser_errors(Broken):
        raise ValueError("\x1b[2J first\nsecond " + "x" * 10_000)
    reason = str(caught.value)
    assert reason.startswith("\\u001b[2J first second xxx")
    assert len(reason) == LONGEST_REASON


def test_own_error_stays_as_it_is() -> None:
    with pytest.raises(UntrustedFile, match=r"^is a folder$"), parser_errors(UntrustedFile):
        raise UntrustedFile("is a folder")


def test_bug_is_not_taken_for_a_broken_file() -> None:
    with pytest.raises(AssertionError), parser_errors(Broken):
        raise AssertionError
