"""The file that says where a run's learner is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from athrl_protocol import ProtocolError
from athrl_protocol.announcements.address_file import (
    ADDRESS_FILE,
    address_announced,
    address_at,
    read_address,
)


def test_folder_names_its_learner_while_it_runs(tmp_path: Path) -> None:
    assert read_address(tmp_path) is None
    with address_announced(tmp_path, "tls/node-7:7447"):
        assert read_address(tmp_path) == "tls/node-7:7447"
        with address_announced(tmp_path, "tls/node-8:7447"):  # that of a learner which was killed is replaced
            assert read_address(tmp_path) == "tls/node-8:7447"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("host", "address"),
    [("node-7", "tls/node-7:7447"), ("10.0.0.7", "tls/10.0.0.7:7447"), ("fd00::7", "tls/[fd00::7]:7447")],
)
def test_address_is_that_of_the_machine_as_others_reach_it(host: str, address: str) -> None:
    assert address_at(host, "tls/0.0.0.0:7447") == address


@pytest.mark.parametrize("host", ["", "node 7", "tls/node-7"])
def test_wrong_host_is_refused(host: str) -> None:
    with pytest.raises(ProtocolError, match="should be a host name or an address"):
        address_at(host, "tls/0.0.0.0:7447")


@pytest.mark.parametrize("content", [b"", b"node-7\n", b"\xff\x00" * 9, b"tls/node-7:99999\n", b"x" * 10**6])
def test_damaged_file_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / ADDRESS_FILE).write_bytes(content)
    with pytest.raises(ProtocolError, match=ADDRESS_FILE) as error:
        read_address(tmp_path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 2_000


def test_pipe_in_place_of_the_file_is_refused_without_a_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / ADDRESS_FILE)
    with pytest.raises(ProtocolError, match=f"{ADDRESS_FILE} is a pipe, socket or device, should be a file"):
        read_address(tmp_path)


def test_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(ProtocolError, match=f"cannot write .*{ADDRESS_FILE}: no such file"),
        address_announced(tmp_path / "missing", "tls/node-7:7447"),
    ):
        pytest.fail("announced")
