"""Make the towns' OpenDRIVE files anew: `python -m towns`, in `driving/`."""

import argparse
from pathlib import Path

from athrl_driving.maps.making.laying import lay_town
from athrl_driving.maps.making.writing import opendrive_text

from towns.town02 import TOWN02
from towns.town03 import TOWN03
from towns.town04 import TOWN04

FOLDER = Path(__file__).parents[1] / "athrl_driving" / "maps" / "towns"

TOWNS = (TOWN02, TOWN03, TOWN04)


def main() -> None:
    """Write one file a town."""
    parser = argparse.ArgumentParser(description="Make the towns' OpenDRIVE files.")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the files go")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for town in TOWNS:
        path = folder / f"{town.name}.xodr"
        path.write_text(opendrive_text(lay_town(town)), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
