"""`athrl run-file`: the settings of a run, documented."""

from __future__ import annotations

from athrl_protocol.run_file import default_toml


def run_file() -> None:
    """Print the default run file: every setting with its default, its meaning and its bounds."""
    print(default_toml(), end="")
