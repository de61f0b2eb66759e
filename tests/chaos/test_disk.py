"""The disk for fault injection: full when requested, free again afterwards, and unmounted in the end."""

from __future__ import annotations

import errno
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.chaos import disk as disks
from tests.chaos.disk import Disk


def mounted(folder: Path) -> bool:
    return f" {folder} " in Path("/proc/mounts").read_text()


def test_full_disk_takes_nothing_until_it_is_emptied_and_keeps_what_it_has(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    with Disk(folder, kept=True) as disk:
        if not disk.permitted:
            pytest.skip("this user may not mount a file system")
        (folder / "before").write_bytes(bytes(50_000))
        disk.fill(0)
        with pytest.raises(OSError, match="No space left") as refused:
            (folder / "meanwhile").write_bytes(bytes(50_000))
        assert refused.value.errno == errno.ENOSPC
        (folder / "meanwhile").unlink()
        disk.fill(100_000)
        (folder / "a little").write_bytes(bytes(50_000))
        with pytest.raises(OSError, match="No space left"):
            (folder / "too much").write_bytes(bytes(100_000))
        disk.empty()
        (folder / "after").write_bytes(bytes(500_000))
        assert mounted(folder)
    assert not mounted(folder)
    sizes = {path.name: path.stat().st_size for path in folder.iterdir()}
    assert (sizes["before"], sizes["a little"], sizes["after"]) == (50_000, 50_000, 500_000)


def test_where_nothing_may_be_mounted_the_folder_is_there_and_the_disk_does_not_claim_to_get_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disks.shutil, "which", lambda name: None)
    with Disk(tmp_path / "disk", kept=True) as disk:
        assert not disk.permitted
        (tmp_path / "disk" / "content").write_text("there")
    assert (tmp_path / "disk" / "content").read_text() == "there"
