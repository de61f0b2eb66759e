"""Writes the log: appends records to segments."""

from __future__ import annotations

import contextlib
import hashlib
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from athrl_spaces.wording import system_reason

from athrl_learner.errors import DiskFull, LogFailed
from athrl_learner.files import NO_SPACE, Files, WritableFile
from athrl_learner.log.records import Kind, encode_header
from athrl_learner.log.segments import (
    SEGMENT_HEADER_BYTES,
    SegmentFacts,
    encode_segment_header,
    numbered_segments,
    segment_name,
)

Fsync = Literal["never", "acknowledgement", "interval"]

#: Seconds for which `close` waits for a sync: a disk that is stuck must not keep the process from ending.
_CLOSE_SECONDS = 30.0


class _OpenSegment:
    """The segment to which records are appended."""

    def __init__(self, file: WritableFile, path: Path, number: int, first: int) -> None:
        self.file = file
        self.path = path
        self.size = SEGMENT_HEADER_BYTES
        self.records = 0
        self._number = number
        self._first = first
        self._checksum = hashlib.sha256()

    def appended(self, header: bytes, body: bytes) -> None:
        self.size += len(header) + len(body)
        self.records += 1
        self._checksum.update(header)

    def facts(self) -> SegmentFacts:
        return SegmentFacts(self._number, self._first, self.records, self.size, self._checksum.hexdigest())


class SegmentLog:
    """Appends records to segments, starts a new segment when one is full, and removes unneeded ones.

    After `append` has returned, a record survives a kill of the process; after `sync` also a power cut. Safe
    to use from several threads; the disk is waited for outside of the lock that `append` takes.
    """

    def __init__(
        self,
        folder: Path,
        *,
        segment_bytes: int,
        fsync: Fsync = "interval",
        reserve_bytes: int = 0,
        files: Files | None = None,
    ) -> None:
        """Prepare a log in `folder` that starts with segment 1 and record 0, unless `continue_from` is
        called.

        Args:
            folder: made with the first segment.
            segment_bytes: size after which a new segment is started.
            fsync: when `commit` syncs records to the disk; "interval" leaves that to calls of `sync`.
            reserve_bytes: disk space that is left for other files, such as checkpoints.
            files: the disk operations.
        """
        self.folder = folder
        self.next_record = 0
        self._files = files or Files()
        self._segment_bytes = segment_bytes
        self._fsync = fsync
        self._reserve_bytes = reserve_bytes
        self._next_segment = 1
        self._sealed: dict[int, SegmentFacts] = {}
        self._current: _OpenSegment | None = None
        self._unsynced: list[WritableFile] = []  # sealed, not yet synced
        self._names_changed = False
        self._dirty = False
        self._failed: LogFailed | None = None
        self._lock = threading.Lock()
        self._syncing = threading.Lock()

    @property
    def next_segment(self) -> int:
        """Number of the next segment."""
        return self._next_segment

    @property
    def size_bytes(self) -> int:
        """Size of all segments that belong to the log, in bytes."""
        with self._lock:
            current = self._current.size if self._current is not None else 0
            return current + sum(facts.bytes for facts in self._sealed.values())

    @property
    def reserve_bytes(self) -> int:
        """Free disk space below which nothing is appended, in bytes."""
        return self._reserve_bytes

    def free_bytes(self) -> int | None:
        """Return the free disk space where the log is, in bytes; None if the file system does not tell."""
        try:
            return self._files.free_bytes(self.folder if self.folder.is_dir() else self.folder.parent)
        except OSError:
            return None

    def continue_from(self, next_segment: int, next_record: int, sealed: Iterable[SegmentFacts]) -> None:
        """Continue a log that was read, after `sealed`; never append to a segment of another process."""
        with self._lock:
            self._next_segment, self.next_record = next_segment, next_record
            self._sealed = {facts.number: facts for facts in sealed}

    def append(self, kind: Kind, body: bytes) -> int:
        """Append a record and return its number.

        Raises:
            DiskFull: there is no space; the log is unchanged.
            LogFailed: the disk reports another error, or did so before.
        """
        with self._lock:
            if self._failed is not None:
                raise self._failed
            header = encode_header(kind, self.next_record, body)
            self._require_space(SEGMENT_HEADER_BYTES + len(header) + len(body))
            segment = self._segment_with_space()
            self._write(segment, header + body)
            segment.appended(header, body)
            self._dirty = True
            self.next_record += 1
            return self.next_record - 1

    def commit(self) -> None:
        """Sync records to the disk if that is to happen with every acknowledgement; raises LogFailed."""
        if self._fsync == "acknowledgement":
            self.sync()

    def sync(self) -> None:
        """Sync every record that was appended before the call to the disk.

        Raises:
            LogFailed: syncing failed. What the disk has is then unknown, so this process may not acknowledge
                anything more.
        """
        with self._syncing:
            with self._lock:
                if self._failed is not None:
                    raise self._failed
                if not self._dirty:
                    return
                sealed, self._unsynced = self._unsynced, []
                current = self._current.file if self._current is not None else None
                names_changed, self._names_changed, self._dirty = self._names_changed, False, False
            try:
                for file in sealed:
                    file.sync()
                    file.close()
                if current is not None:
                    current.sync()
                if names_changed:
                    self._files.sync_folder(self.folder)
            except OSError as error:
                # A second try could succeed without effect: the kernel has dropped what it could not write.
                self._failed = LogFailed(
                    f"cannot sync the log {self.folder} to the disk: {system_reason(error)}"
                )
                raise self._failed from None

    def seal(self) -> list[SegmentFacts]:
        """End the current segment and return all sealed ones, oldest first. Does not wait for the disk."""
        with self._lock:
            self._seal()
            return list(self._sealed.values())

    def keep_only(self, oldest: int, named: set[int]) -> int:
        """Remove segments before number `oldest` that are not `named`; return how many. The open one stays.

        A segment that cannot be removed stays, too; it is tried again next time.
        """
        with self._lock:
            ended = self._next_segment - (self._current is not None)
        removed = 0
        for number, path in numbered_segments(self.folder).items():
            if number >= min(oldest, ended) or number in named:
                continue
            with contextlib.suppress(OSError):
                self._files.remove(path)
                removed += 1
                with self._lock:
                    self._sealed.pop(number, None)
        return removed

    def remove_later_segments(self) -> int:
        """Remove segments that an earlier process wrote after the start of this log; return how many.

        Raises:
            LogFailed: one cannot be removed.
        """
        later = [
            path for number, path in numbered_segments(self.folder).items() if number >= self._next_segment
        ]
        try:
            for path in reversed(later):  # so that a kill leaves no gap
                self._files.remove(path)
        except OSError as error:
            raise LogFailed(f"cannot remove {path}: {system_reason(error)}") from None
        return len(later)

    def close(self) -> None:
        """Close the files; appended records stay. Leaves them to the process's end if the disk is stuck."""
        if not self._syncing.acquire(timeout=_CLOSE_SECONDS):
            return
        try:
            with self._lock:
                self._seal()
                for file in self._unsynced:
                    file.close()
                self._unsynced.clear()
        finally:
            self._syncing.release()

    def _require_space(self, size: int) -> None:
        if not self._reserve_bytes:
            return
        free = self.free_bytes()
        if free is None:
            return  # the file system reports it when writing
        if free - size < self._reserve_bytes:
            raise DiskFull(
                f"the disk of {self.folder} has {free / 2**20:.0f} MiB left, "
                f"{self._reserve_bytes / 2**20:.0f} MiB are reserved for checkpoints: make room"
            )

    def _segment_with_space(self) -> _OpenSegment:
        if self._current is not None and self._current.size >= self._segment_bytes:
            self._seal()
        if self._current is None:
            self._current = self._begin()
        return self._current

    def _begin(self) -> _OpenSegment:
        path = self.folder / segment_name(self._next_segment)
        try:
            self._files.make_folder(self.folder)
            file = self._files.create(path)
            try:
                file.write(encode_segment_header(self._next_segment, self.next_record))
            except OSError:
                file.close()
                self._files.remove(path)
                raise
        except OSError as error:
            raise self._refusal(error) from None
        self._next_segment += 1
        self._names_changed = True
        return _OpenSegment(file, path, self._next_segment - 1, self.next_record)

    def _write(self, segment: _OpenSegment, content: bytes) -> None:
        try:
            segment.file.write(content)
        except OSError as error:
            try:
                segment.file.truncate(segment.size)
            except OSError:
                self._failed = LogFailed(f"{segment.path} ends in a partial record that cannot be removed")
                raise self._failed from None
            raise self._refusal(error) from None

    def _refusal(self, error: OSError) -> DiskFull | LogFailed:
        if error.errno in NO_SPACE:
            return DiskFull(f"the disk of {self.folder} is full: make room")
        return LogFailed(f"cannot write the log {self.folder}: {system_reason(error)}")

    def _seal(self) -> None:
        if self._current is None:
            return
        facts = self._current.facts()
        self._sealed[facts.number] = facts
        self._unsynced.append(self._current.file)
        self._current = None
