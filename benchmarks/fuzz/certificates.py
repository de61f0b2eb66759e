"""Files in a folder of certificates, as a service, `athrl certificates` and `athrl doctor` read them."""

from __future__ import annotations

import base64
import random
import textwrap
from pathlib import Path

from athrl.certificate_files import load_certificate
from athrl.certificates import make_all, renew_roles
from athrl.doctor import network
from athrl.errors import CommandError
from athrl_protocol import ProtocolError, read_run_file
from athrl_protocol.security.certificates import find_certificates, read_bound_names

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser


def certificate(folder: Path) -> Parser:
    """Return the parser of a service's certificate."""
    return _file(folder, "learner/tls.crt")


def key(folder: Path) -> Parser:
    """Return the parser of a service's key."""
    return _file(folder, "learner/tls.key")


def authority_key(folder: Path) -> Parser:
    """Return the parser of the authority's key, which signs new certificates."""
    return _file(folder, "authority/tls.key")


def actors(folder: Path) -> Parser:
    """Return the parser of the names of actors that are bound to certificates."""
    return _file(folder, "learner/actors.txt")


def _file(folder: Path, name: str) -> Parser:
    make_all(folder, ["localhost"], 30, actors=["rig-1", "rig-2"])
    path = folder / name
    settings = read_run_file(None, [f"network.certificates={path.parent}"])

    def read_authority(path: Path) -> None:
        renew_roles(folder, ["viewer"], None, 30)

    def read_service(path: Path) -> None:
        list(network.certificates(settings))
        found = find_certificates(folder, "learner")
        assert found is not None
        found.check_may_serve("learner")
        read_bound_names(found)
        load_certificate(found.certificate)

    read = read_authority if path.parent.name == "authority" else read_service

    ways = [*mutations.BYTES, mutations.odd_characters, _changed_inside, _changed_inside]
    return file_parser([path.read_bytes()], ways, path, read, ProtocolError, CommandError)


def _changed_inside(chance: random.Random, content: bytes) -> bytes:
    """Return the file with other bytes under its base64."""
    lines = content.split(b"\n")
    if len(lines) < 4:
        return mutations.changed_bytes(chance, content)
    inside = base64.b64decode(b"".join(line for line in lines if line and not line.startswith(b"-----")))
    changed = chance.choice([mutations.changed_bytes, mutations.cut_or_stretched])(chance, inside)
    body = "\n".join(textwrap.wrap(base64.b64encode(changed).decode(), 64)).encode()
    return b"\n".join([lines[0], body, lines[-2], b""])
