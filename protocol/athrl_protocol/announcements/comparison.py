"""The file of a run's closing comparison, by which a finished run is known."""

from __future__ import annotations

from pathlib import Path

from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_json

COMPARISON_FILE = "evaluation.json"


def compared_decisions(folder: Path) -> int:
    """Return the number of decisions at the closing comparison in a run's folder; 0 if there is none."""
    try:
        with parser_errors(UntrustedFile):
            return int(read_json(folder / COMPARISON_FILE)["environment_steps"])
    except UntrustedFile:
        return 0  # missing, or not written by a run
