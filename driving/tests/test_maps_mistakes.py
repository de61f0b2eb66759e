"""Whatever is wrong in a file: it is read, or refused in one line."""

from pathlib import Path
from xml.etree import ElementTree

import athrl_driving.maps.town
import pytest
from athrl_driving.maps import MapError, load_town

TEXT = (Path(athrl_driving.maps.town.__file__).parent / "towns" / "town02.xodr").read_text()
PLACES = sorted({(item.tag, name) for item in ElementTree.fromstring(TEXT).iter() for name in item.attrib})


def refusal(path: Path, root: ElementTree.Element) -> str:
    """Return what loading says, empty where it works; other errors than a map's go through."""
    path.write_bytes(ElementTree.tostring(root))
    try:
        load_town(path)
    except MapError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("value", [None, "x", "-1"])
def test_a_wrong_attribute_makes_no_traceback(tmp_path: Path, value: str | None) -> None:
    refusals = []
    for place, (tag, attribute) in enumerate(PLACES):
        root = ElementTree.fromstring(TEXT)
        item = next(item for item in root.iter(tag) if attribute in item.attrib)
        if value is None:
            del item.attrib[attribute]
        else:
            item.attrib[attribute] = value
        refusals.append(refusal(tmp_path / f"{place}.xodr", root))
    assert not any("\n" in text for text in refusals)
    assert sum(bool(text) for text in refusals) > 5


def test_a_missing_element_makes_no_traceback(tmp_path: Path) -> None:
    refusals = {}
    for tag in {tag for tag, _ in PLACES} - {"OpenDRIVE"}:
        root = ElementTree.fromstring(TEXT)
        parent = next(item for item in root.iter() if item.find(tag) is not None)
        for child in parent.findall(tag):
            parent.remove(child)
        refusals[tag] = refusal(tmp_path / f"{tag}.xodr", root)
    assert not any("\n" in text for text in refusals.values())
    assert refusals["road"]
    # One road without a reference line or without lanes is left out, as if it had been cut away.
    assert not refusals["geometry"]
    assert not refusals["laneSection"]
