"""What becomes of maps that other libraries write: `python -m benchmarks.public_maps`.

Each is written, loaded and driven on for 20 s; the table is that of the documents. The last line is one JSON
object. `pip install eclipse-sumo` (150 MB) adds SUMO's networks. With --folder the files are kept.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks.public_maps import describe, writers
from benchmarks.public_maps.trial import Trial, try_map

_HEAD = "| written by | what it shows | lanes, km | left out, m | driven in 20 s, m |"


def main() -> None:
    """Write, load, drive, and print a line for each map."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="where the maps are kept; default: nowhere")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        print(f"{_HEAD}\n|---|---|---:|---:|---:|")
        found = {}
        for name, write in writers().items():
            path = folder / f"{name.replace('/', '-')}.xodr"
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
            found[name] = try_map(path)
            print(_row(name, found[name]), flush=True)
    print(json.dumps({name: asdict(trial) for name, trial in found.items()}))


def _row(name: str, trial: Trial) -> str:
    library = name.partition("/")[0]
    if trial.facts is None:
        return f"| {library} | {describe(name)} | refused: {trial.refusal} | | |"
    facts = trial.facts
    return (
        f"| {library} | {describe(name)} | {trial.kilometres:.2f} | {facts.metres_left_out:.0f} | "
        f"{trial.metres:.0f} |"
    )


if __name__ == "__main__":
    main()
