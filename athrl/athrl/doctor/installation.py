"""Checks that the installed packages fit together."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import athrl_protocol.messages.athrl_pb2

from athrl.doctor.finding import Finding, failed, ok, warning

PACKAGES = (
    "athrl-protocol",
    "athrl-driving",
    "athrl-planners",
    "athrl-actor",
    "athrl-learner",
    "athrl-evaluator",
)
ZENOH = "1.10"
"""The tested version."""
_VIEWER_SECONDS = 20.0


def installation() -> Iterator[Finding]:
    """Check the versions of athrl's distributions and of their dependencies."""
    own = metadata.version("athrl")
    yield ok("python", f"{sys.version.split()[0]}, athrl {own}")
    yield from _packages(own)
    yield from _dependencies()
    yield from _zenoh()
    yield from _protobuf()
    yield from _rerun()


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _packages(own: str) -> Iterator[Finding]:
    there = {name: version for name in PACKAGES if (version := _version(name)) is not None}
    others = [f"{name} {version}" for name, version in there.items() if version != own]
    if others:
        yield failed(
            "services", f"athrl {own} with {', '.join(others)}", f"install all of them in version {own}"
        )
    else:
        yield ok("services", ", ".join(name.removeprefix("athrl-") for name in there))


def _dependencies() -> Iterator[Finding]:
    """Check for missing distributions that an installed package requires."""
    missing = []
    for package in ("athrl", *PACKAGES):
        if _version(package) is None:
            continue
        for requirement in metadata.requires(package) or []:
            name = re.match(r"[A-Za-z0-9._-]+", requirement)
            if ";" not in requirement and name is not None and _version(name[0]) is None:
                missing.append(f"{name[0]} (of {package})")
    if missing:
        yield failed("dependencies", f"not installed: {', '.join(missing)}", "pip install them")
    else:
        yield ok("dependencies", "all installed")


def _zenoh() -> Iterator[Finding]:
    version = _version("eclipse-zenoh") or "none"
    if version.startswith(f"{ZENOH}."):
        yield ok("zenoh", version)
    else:
        yield warning("zenoh", version, f"tested with {ZENOH}: pip install 'eclipse-zenoh~={ZENOH}.0'")


def _protobuf() -> Iterator[Finding]:
    """Report both versions; importing the generated code has already refused an older runtime."""
    code = Path(athrl_protocol.messages.athrl_pb2.__file__).read_text()
    generated = re.search(r"Protobuf Python Version: (\S+)", code)
    yield ok(
        "protobuf",
        f"runtime {_version('protobuf')}, messages generated for {generated[1] if generated else 'any'}",
    )


def _rerun() -> Iterator[Finding]:
    sdk = _version("rerun-sdk")
    if sdk is None:
        return
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        yield warning("rerun", f"SDK {sdk}, no viewer", f"pip install --force-reinstall rerun-sdk=={sdk}")
        return
    try:
        said = subprocess.run(
            [viewer, "--version"], capture_output=True, text=True, timeout=_VIEWER_SECONDS
        ).stdout
    except subprocess.TimeoutExpired:
        said = ""
    found = re.search(r"\d+\.\d+\.\d+", said)
    if found is not None and found[0] == sdk:
        yield ok("rerun", f"SDK and viewer {sdk}")
    else:
        yield warning(
            "rerun",
            f"SDK {sdk}, but the viewer {viewer} is {found[0] if found else 'silent'}",
            f"they must be the same: pip install --force-reinstall rerun-sdk=={sdk}",
        )
