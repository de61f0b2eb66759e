"""What a recorded episode was driven with, so that `athrl replay` can drive it again.

In the file it is a metadata record, as short texts by name; docs/reference/recordings.md lists them.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.metadata import version
from typing import Any

from athrl_driving.envs import EnvView
from athrl_driving.kernels.compilation import fingerprint
from athrl_spaces.untrusted import one_line

METADATA = "athrl.episode"
"""Name of the metadata record."""
MOST_CHARACTERS = 65_536
"""Of the settings."""
LONGEST_TEXT = 200
"""Characters of each other text, which is shown to people."""
MOST_SEED = 2**64 - 1


@dataclass(frozen=True)
class Origin:
    """The seed and the settings of an episode, and what computed it."""

    seed: int
    settings: Mapping[str, Any]
    """All settings of the environment, the town among them."""
    town_checksum: str
    """SHA-256 of the town's file, hexadecimal."""
    kernels: str
    """Hash of the compiled simulation: its sources, the compiler and the processor."""
    numpy: str
    """Its version: it lays out the town."""
    athrl: str
    """Version of athrl-driving."""
    processor: str
    """For people: the architecture."""
    policy: str = ""
    """For people: the name of the policy's file; empty of another driver, and of older recordings."""

    @classmethod
    def of(cls, environment: EnvView, seed: int, policy: str = "") -> Origin:
        """The origin of an episode that begins in an environment now, in this process."""
        assert environment.town.file is not None  # an evaluation's towns are loaded by name
        checksum = environment.town.file.checksum
        return cls(
            seed, environment.config, checksum, **computed_by(), policy=one_line(policy)[:LONGEST_TEXT]
        )

    def metadata(self) -> dict[str, str]:
        """The texts of the metadata record."""
        texts = {name: str(value) for name, value in vars(self).items()}
        return {**texts, "settings": json.dumps(dict(self.settings))}

    @classmethod
    def from_metadata(cls, texts: Mapping[str, str]) -> Origin:
        """Read the texts of a metadata record; raises ValueError or LookupError where they are no origin."""
        if len(texts["settings"]) > MOST_CHARACTERS:
            raise ValueError(f"its settings have over {MOST_CHARACTERS:,} characters")
        settings = json.loads(texts["settings"])
        if not isinstance(settings, dict) or not isinstance(settings.get("town"), str):
            raise ValueError("its settings name no town")
        seed = int(texts["seed"])
        if not 0 <= seed <= MOST_SEED:
            raise ValueError(f"its seed is {seed}, it should be from 0 to 2^64 - 1")
        others = ("town_checksum", "kernels", "numpy", "athrl", "processor")
        found = {name: texts[name] for name in others} | {"policy": texts.get("policy", "")}
        for name, text in found.items():
            if len(text) > LONGEST_TEXT or not text.isprintable():
                raise ValueError(
                    f"its {name} should be a printable text of at most {LONGEST_TEXT} characters"
                )
        return cls(seed, settings, **found)


ORIGIN_KEYS = frozenset(field.name for field in fields(Origin))
"""Of the texts of a metadata record."""


def computed_by() -> dict[str, str]:
    """What determines the last bits of an episode in this process, by its name in `Origin`."""
    return {
        "kernels": fingerprint(),
        "numpy": version("numpy"),
        "athrl": version("athrl-driving"),
        "processor": platform.machine(),
    }
