"""Print what the given rooms need from a package registry, one requirement a line.

An image installs these before any code is copied, so that a change of code does not install them again.
"""

import sys
import tomllib
from pathlib import Path


def third_party(rooms: list[str]) -> list[str]:
    """Return the requirements in the rooms' pyproject.toml that are not rooms themselves."""
    requirements: set[str] = set()
    for room in rooms:
        project = tomllib.loads(Path(room, "pyproject.toml").read_text())["project"]
        requirements.update(name for name in project["dependencies"] if not name.startswith("athrl"))
    return sorted(requirements)


if __name__ == "__main__":
    print("\n".join(third_party(sys.argv[1:])))
