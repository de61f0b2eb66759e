"""Where a town comes from: by it a copy of an environment finds the same town again."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

_DIGITS_SHOWN = 12


@dataclass(frozen=True, slots=True)
class TownFile:
    """Names the file of a town: `name` is that of a town of the project, or the file's whole path.

    A random town has a name and no file.
    """

    name: str
    checksum: str
    """SHA-256 of the file's content, hexadecimal; of a random town, of how it is drawn."""
    strict: bool
    """Whether it was read strictly."""

    @property
    def short_checksum(self) -> str:
        """The first digits, enough for telling two maps apart in a message."""
        return f"{self.checksum[:_DIGITS_SHOWN]}..."


def town_file(name: str, path: Path, strict: bool) -> TownFile:
    """Return the `TownFile` of what is at `path` now, for the name by which it is loaded again."""
    with path.open("rb") as file:
        return TownFile(name, hashlib.file_digest(file, "sha256").hexdigest(), strict)
