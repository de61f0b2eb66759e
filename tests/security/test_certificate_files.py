"""A file in a folder of certificates that is none is named in one line; nobody waits for it or is asked."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from athrl.certificate_files import load_certificate, names_in
from athrl.errors import CommandError
from athrl_protocol import ProtocolError
from athrl_protocol.security.certificates import MOST_BYTES, find_certificates, read_bound_names
from cryptography.hazmat.primitives import serialization

from athrl import certificates


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a certificate of every role."""
    certificates.make_all(tmp_path / "certificates", ["localhost"], days=30, actors=["rig-1"])
    return tmp_path / "certificates"


def encrypt(path: Path) -> None:
    key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    path.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.BestAvailableEncryption(b"secret"),
        )
    )


def replace_by(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def replace(path: Path) -> None:
        path.unlink()
        make(path)

    return replace


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "nonsense": (lambda path: path.write_bytes(b"-----BEGIN CERTIFICATE-----\n\xff\0"), "is n"),
    "nothing": (lambda path: path.write_bytes(b""), "is n"),
    "large": (lambda path: os.truncate(path, MOST_BYTES + 1), "is too large"),
    "pipe": (replace_by(os.mkfifo), "is a pipe, socket or device, should be a file"),
    "device": (replace_by(lambda path: path.symlink_to("/dev/zero")), "is a pipe, socket or device"),
    "folder": (replace_by(os.mkdir), "is a folder, should be a file"),
}


def one_line(error: Exception) -> str:
    text = str(error)
    assert text == " ".join(text.split())
    return text


@pytest.mark.parametrize("name", ["ca.crt", "tls.crt", "tls.key"])
@pytest.mark.parametrize(("make", "told"), WRONG.values(), ids=WRONG)
def test_service_is_told_which_file_is_wrong(
    folder: Path, name: str, make: Callable[[Path], object], told: str
) -> None:
    path = folder / "learner" / name
    make(path)
    with pytest.raises(ProtocolError) as caught:
        find_certificates(folder, "learner")
    line = one_line(caught.value)
    assert str(path.parent) in line
    assert told in line


def test_key_with_a_password_is_refused_and_nobody_is_asked_for_it(folder: Path) -> None:
    path = folder / "actor" / "tls.key"
    encrypt(path)
    with pytest.raises(ProtocolError, match=rf"^{path} is encrypted with a password"):
        find_certificates(folder, "actor")
    encrypt(folder / "authority" / "tls.key")
    with pytest.raises(CommandError, match=r"authority/tls.key is not the key of"):
        certificates.renew_roles(folder, ["viewer"], None, days=30)


@pytest.mark.parametrize(("make", "told"), WRONG.values(), ids=WRONG)
def test_command_is_told_which_certificate_is_wrong(
    folder: Path, make: Callable[[Path], object], told: str
) -> None:
    path = folder / "authority" / "tls.crt"
    make(path)
    with pytest.raises(CommandError, match=str(path)) as caught:
        load_certificate(path)
    assert told in one_line(caught.value)


def test_certificate_without_host_names_is_named(folder: Path) -> None:
    path = folder / "authority" / "tls.crt"
    with pytest.raises(CommandError, match=rf"^{path} has no host names"):
        names_in(path)


@pytest.mark.parametrize("content", [b"\xff\xfe", b"a/b\n", b"x" * (MOST_BYTES + 1), b"\x1b[2J\n"])
def test_names_of_actors_that_are_none_name_the_file(folder: Path, content: bytes) -> None:
    found = find_certificates(folder, "learner")
    assert found is not None
    assert read_bound_names(found) == ("rig-1",)
    path = folder / "learner" / "actors.txt"
    path.write_bytes(content)
    with pytest.raises(ProtocolError, match=str(path)) as caught:
        read_bound_names(found)
    one_line(caught.value)
