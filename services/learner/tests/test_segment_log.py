"""The log of experience: what was appended is read back, whatever dies, fails, fills up or is damaged."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from athrl_learner.errors import DiskFull, LogFailed
from athrl_learner.files import Files
from athrl_learner.log import (
    Damage,
    IntervalSync,
    Kind,
    LogPosition,
    SegmentFacts,
    SegmentLog,
    SegmentReader,
    needed_segments,
    numbered_segments,
)
from athrl_learner.log.records import HEADER_BYTES
from athrl_learner.log.segments import (
    SEGMENT_HEADER_BYTES,
    decode_segment_header,
    encode_segment_header,
)
from hypothesis import given, settings
from hypothesis import strategies as some


def make_log(folder: Path, files: Files | None = None, **settings: object) -> SegmentLog:
    return SegmentLog(folder, **{"segment_bytes": 400, "fsync": "never", "files": files, **settings})


def read(folder: Path) -> tuple[list[bytes], list[Damage]]:
    """All bodies and all damages, segment after segment."""
    bodies, damages = [], []
    for number, path in numbered_segments(folder).items():
        for item in SegmentReader(path, number, 0):
            if isinstance(item, Damage):
                damages.append(item)
            else:
                bodies.append(item.body)
    return bodies, damages


def body(number: int) -> bytes:
    return b"%d-" % number * (10 + number % 7)


def test_records_are_read_back_in_order_over_many_segments(tmp_path):
    log = make_log(tmp_path)
    numbers = [log.append(Kind.CHUNK, body(number)) for number in range(50)]
    log.close()
    assert numbers == list(range(50))
    assert len(numbered_segments(tmp_path)) > 3
    assert read(tmp_path) == ([body(number) for number in range(50)], [])


def test_what_a_sealed_segment_says_of_itself_is_what_is_found_in_it(tmp_path):
    log = make_log(tmp_path)
    for number in range(20):
        log.append(Kind.CHUNK if number % 3 else Kind.REFUSAL, body(number))
    said = log.seal()
    found = []
    for number, path in numbered_segments(tmp_path).items():
        reader = SegmentReader(path, number, 0)
        list(reader)
        found.append(reader.facts())
    assert found == said
    assert sum(facts.records for facts in said) == 20
    assert log.size_bytes == sum(path.stat().st_size for path in tmp_path.iterdir())


def test_half_a_record_at_the_end_is_torn_and_the_rest_is_intact(tmp_path):
    log = make_log(tmp_path, segment_bytes=10_000)
    for number in range(5):
        log.append(Kind.CHUNK, body(number))
    log.close()
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    last = len(whole) - HEADER_BYTES - len(body(4))
    for size in range(last + 1, len(whole)):
        path.write_bytes(whole[:size])
        bodies, (damage,) = read(tmp_path)
        assert bodies == [body(number) for number in range(4)]
        assert (damage.torn, damage.start, damage.path) == (True, last, path)


def eight_records(folder):
    """Write a log of one segment; return its records' bodies and the segment's path."""
    log = make_log(folder, segment_bytes=10_000)
    bodies = [body(number) for number in range(8)]
    for content in bodies:
        log.append(Kind.CHUNK, content)
    log.close()
    (path,) = folder.iterdir()
    return bodies, path


@given(place=some.integers(0, 10_000), bit=some.integers(0, 7))
@settings(deadline=None, max_examples=200)
def test_a_flipped_bit_costs_one_record_and_is_named(tmp_path_factory, place, bit):
    folder = tmp_path_factory.mktemp("log")
    expected, path = eight_records(folder)
    whole = bytearray(path.read_bytes())
    place %= len(whole)
    whole[place] ^= 1 << bit
    path.write_bytes(whole)
    bodies, damages = read(folder)
    if place < SEGMENT_HEADER_BYTES:
        assert bodies == expected
    else:
        assert len(bodies) == 7
        assert [content for content in expected if content in bodies] == bodies
    (damage,) = damages
    assert damage.start <= place < damage.end
    assert str(path) in str(damage)


def test_no_flipped_bit_of_a_header_costs_a_record(tmp_path):
    expected, path = eight_records(tmp_path)
    whole = path.read_bytes()
    for bit in range(8 * SEGMENT_HEADER_BYTES):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        bodies, (damage,) = read(tmp_path)
        assert bodies == expected, bit
        assert (damage.start, damage.path) == (0, path), bit


def fill(log: SegmentLog, appended: list[bytes], size: int = 20) -> None:
    """Append as long as the log permits."""
    while True:
        content = b"%d-" % len(appended) * size
        log.append(Kind.CHUNK, content)
        appended.append(content)


def append_until_it_ends(log: SegmentLog, appended: list[bytes]) -> None:
    """Append and seal; `appended` has what was promised, and the log may have one record more."""
    for number in range(12):
        log.append(Kind.CHUNK, body(number))
        appended.append(body(number))
        if number == 6:
            log.seal()
            log.sync()
    log.sync()


def test_a_death_at_any_operation_loses_nothing_that_was_appended(tmp_path, faults):
    complete = faults.FaultyFiles()
    append_until_it_ends(make_log(tmp_path / "whole", complete), [])
    assert complete.operations > 20
    for operation in range(complete.operations):
        folder = tmp_path / str(operation)
        appended: list[bytes] = []
        with pytest.raises(faults.Died):
            append_until_it_ends(make_log(folder, faults.FaultyFiles(dies_at=operation)), appended)
        bodies, damages = read(folder)
        assert bodies[: len(appended)] == appended
        assert len(bodies) <= len(appended) + 1
        assert all(damage.torn for damage in damages)
        assert len(damages) <= 1


def test_an_error_at_any_operation_is_told_and_loses_nothing(tmp_path, faults):
    complete = faults.FaultyFiles()
    append_until_it_ends(make_log(tmp_path / "whole", complete), [])
    for operation in range(complete.operations):
        folder = tmp_path / str(operation)
        appended: list[bytes] = []
        with pytest.raises(LogFailed, match="cannot"):
            append_until_it_ends(make_log(folder, faults.FaultyFiles(fails_at=operation)), appended)
        assert read(folder) == (appended, [])


def test_after_a_failed_sync_nothing_more_is_promised(tmp_path, faults):
    files = faults.FaultyFiles()
    log = make_log(tmp_path, files, fsync="acknowledgement")
    log.append(Kind.CHUNK, b"a")
    files.fails_at = files.operations
    for _ in range(2):
        with pytest.raises(LogFailed, match="to the disk"):
            log.commit()
    with pytest.raises(LogFailed, match="to the disk"):
        log.append(Kind.CHUNK, b"b")


def test_a_disk_that_is_stuck_in_a_sync_does_not_keep_the_log_from_closing(tmp_path, faults, monkeypatch):
    monkeypatch.setattr("athrl_learner.log.writing._CLOSE_SECONDS", 0.05)
    files, stuck, goes_on = faults.FaultyFiles(), threading.Event(), threading.Event()
    log = make_log(tmp_path, files)
    log.append(Kind.CHUNK, b"a")
    monkeypatch.setattr(files, "turn", lambda size=0: (stuck.set(), goes_on.wait(30)))
    syncing = threading.Thread(target=log.sync, daemon=True)
    syncing.start()
    try:
        assert stuck.wait(30)
        log.close()
        assert syncing.is_alive()
    finally:
        goes_on.set()
        syncing.join(30)
    assert read(tmp_path) == ([b"a"], [])


@pytest.mark.parametrize("free_space", range(0, 700, 13))
def test_a_full_disk_leaves_whole_records_and_continues_when_there_is_space(tmp_path, free_space, faults):
    files = faults.FaultyFiles(free_space=free_space)
    log = make_log(tmp_path, files)
    appended = []
    with contextlib.suppress(DiskFull):
        fill(log, appended)
    for _ in range(3):
        with pytest.raises(DiskFull, match=f"the disk of {tmp_path} is full"):
            log.append(Kind.CHUNK, b"x" * 1000)
    assert read(tmp_path) == (appended, [])
    files.free_space = None
    assert log.append(Kind.CHUNK, b"after") == len(appended)
    assert read(tmp_path) == ([*appended, b"after"], [])


def test_space_is_left_for_checkpoints(tmp_path, faults):
    files = faults.FaultyFiles(free_space=10_000)
    log = make_log(tmp_path, files, reserve_bytes=9_000)
    with pytest.raises(DiskFull, match="are reserved for checkpoints"):
        fill(log, [])
    assert files.free_space >= 9_000


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 KiB; skips where this user may mount none."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("only root mounts a file system")
    if subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], capture_output=True
    ).returncode:
        pytest.skip("this machine lets no file system be mounted")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_a_disk_that_is_really_full_loses_nothing(tiny_disk):
    log = make_log(tiny_disk / "experience", segment_bytes=50_000)
    ballast = tiny_disk / "ballast"
    ballast.write_bytes(bytes(100_000))
    appended = []
    with pytest.raises(DiskFull, match="is full"):
        fill(log, appended, 1000)
    assert len(appended) > 10
    assert read(log.folder) == (appended, [])
    ballast.unlink()
    assert log.append(Kind.CHUNK, b"after") == len(appended)
    log.sync()
    log.close()
    assert read(log.folder) == ([*appended, b"after"], [])


def test_with_fsync_a_power_cut_takes_nothing_that_was_committed(tmp_path, faults):
    for fsync, left in (("acknowledgement", 9), ("never", 0)):
        log = make_log(tmp_path / fsync, faults.PowerCutFiles(), fsync=fsync)
        for number in range(10):
            log.append(Kind.CHUNK, body(number))
            if number < 9:
                log.commit()
        bodies, _ = read(tmp_path / fsync)
        assert bodies[:left] == [body(number) for number in range(left)]
        assert fsync == "acknowledgement" or not bodies


def test_at_an_interval_the_log_comes_to_the_disk_by_itself(tmp_path, wait_for, faults):
    log = make_log(tmp_path, faults.PowerCutFiles(), fsync="interval")
    with IntervalSync(log, 0.01):
        log.append(Kind.CHUNK, body(1))
        wait_for(lambda: read(tmp_path)[0] == [body(1)])


def facts(number: int) -> SegmentFacts:
    return SegmentFacts(number, number * 10, 10, 1000, "")


def position(first: int, last: int) -> LogPosition:
    return LogPosition(last + 1, (last + 1) * 10, first * 10, 1, tuple(map(facts, range(first, last + 1))))


def test_segments_go_when_no_kept_checkpoint_needs_them(tmp_path):
    log = make_log(tmp_path)
    for number in range(60):
        log.append(Kind.CHUNK, body(number))
    present = set(numbered_segments(tmp_path))
    needed = needed_segments([position(5, 7), position(6, 8)], [position(2, 3)])
    assert log.keep_only(*needed) == 2
    assert set(numbered_segments(tmp_path)) == {2, 3} | {number for number in present if number >= 5}
    assert log.keep_only(*needed_segments([], [])) == 0
    # The segment that is being written stays, whatever is asked for.
    log.keep_only(10_000, set())
    assert set(numbered_segments(tmp_path)) == {max(present)}
    log.append(Kind.CHUNK, b"still there")
    assert read(tmp_path)[0][-1] == b"still there"


def test_numbers_at_the_end_of_their_range_are_no_segment_of_ours(tmp_path):
    (tmp_path / "segment-999999999999999999.log").touch()
    assert numbered_segments(tmp_path) == {}
    log = SegmentLog(tmp_path, segment_bytes=10**6, fsync="never")
    log.append(Kind.CHUNK, b"body")
    log.close()
    assert list(numbered_segments(tmp_path)) == [1]
    assert decode_segment_header(memoryview(encode_segment_header(1, 2**63))) is None
    assert decode_segment_header(memoryview(encode_segment_header(1, 5))) is not None
