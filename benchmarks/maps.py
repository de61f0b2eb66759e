"""The maps that benchmarks run on, and how long each takes to load: `python -m benchmarks.maps`.

They are the project's towns, and CARLA's maps where a folder has them. For each the least CPU time of several
loads is printed, beside that of the XML parser alone on the same file. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_driving import maps
from athrl_driving.errors import DrivingError
from athrl_driving.maps import TOWNS, load_town
from lxml import etree  # type: ignore[import-untyped]

_OWN = Path(maps.__file__).parent / "towns"
_CARLA = Path(os.environ.get("ATHRL_TOWNS", Path(__file__).resolve().parents[2] / "shared" / "towns"))
_REPEATS = 5


def add_map_options(parser: argparse.ArgumentParser) -> None:
    """Let the user choose maps."""
    parser.add_argument("--maps", nargs="+", help="names of towns or paths of OpenDRIVE files; default: all")
    parser.add_argument("--carla", type=Path, default=_CARLA, help="folder with CARLA's maps")


def chosen_maps(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the chosen maps: what to call each, and what `load_town` knows it by."""
    chosen = arguments.maps or [*TOWNS, *map(str, sorted(arguments.carla.glob("*.xodr")))]
    return {_label(name, arguments.carla): name for name in chosen}


def _label(name: str, carla: Path) -> str:
    """What to call a map; one of neither is called by its path, as others may have its name."""
    if name in TOWNS:
        return name
    called = load_town(name).name  # one that cannot be used is refused before anything is measured
    return f"CARLA {called}" if Path(name).parent == carla else name


@contextmanager
def told_in_one_line() -> Iterator[None]:
    """End the program with one line where a map cannot be used, or has no room for the vehicles."""
    try:
        yield
    except DrivingError as error:
        sys.exit(str(error))


def load_seconds(file: Path) -> tuple[float, float]:
    """Return the CPU seconds of loading a map, and of the XML parser alone."""
    text = file.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        # A process reads a file once, so each load gets a copy.
        copies = [shutil.copy(file, Path(folder) / f"{number}.xodr") for number in range(_REPEATS)]
        loading = min(_cpu_seconds(lambda copy=copy: load_town(copy)) for copy in copies)
    return loading, min(_cpu_seconds(lambda: etree.fromstring(text)) for _ in range(_REPEATS))


def _cpu_seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_map_options(parser)
    arguments = parser.parse_args()

    print(f"{'map':<16}{'MB':>6}{'lanes, km':>11}{'loaded, s':>11}{'XML alone, s':>14}")
    results = {}
    for label, name in chosen_maps(arguments).items():
        file = _OWN / f"{name}.xodr" if name in TOWNS else Path(name)
        loading, parsing = load_seconds(file)
        megabytes, kilometres = file.stat().st_size / 1e6, load_town(name).lane_kilometres
        results[label] = {
            "megabytes": megabytes,
            "kilometres": kilometres,
            "seconds": loading,
            "xml": parsing,
        }
        print(f"{label:<16}{megabytes:>6.1f}{kilometres:>11.1f}{loading:>11.2f}{parsing:>14.3f}", flush=True)
    print(json.dumps({"repeats": _REPEATS, "maps": results}))


if __name__ == "__main__":
    with told_in_one_line():
        main()
