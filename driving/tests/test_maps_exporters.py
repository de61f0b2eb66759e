"""What programs write with which people draw maps: it is read for what it means, also beside the standard."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from athrl_driving.maps import MapError, Town, load_town
from athrl_driving.maps.opendrive import read_opendrive

from driving.tests.faulty_maps import (
    LINKS,
    WIDTH,
    geometry,
    kinds,
    lane,
    metres,
    ring,
    road,
    section,
    town_from,
)

TO_2, FROM_2 = (
    LINKS.replace(f'<{tag} id="-1"/>', f'<{tag} id="-2"/>') for tag in ("successor", "predecessor")
)


def polynomial(speed: float, span: str = "") -> str:
    zeros = " ".join(f'{name}="0"' for name in ("aU", "cU", "dU", "aV", "bV", "cV", "dV"))
    return geometry(0, 0, 0, shape=f'<paramPoly3 bU="{speed}" {zeros} {span}/>')


def with_lane(widths: str, *others: str) -> str:
    return ring(road(1, geometry(0, 0, 0), sections=section(lane(widths=widths), *others)))


def with_speed(text: str) -> str:
    return ring(road(1, geometry(0, 0, 0), before=f'<type s="0" type="town"><speed {text}/></type>'))


def single(side: str, *numbers: int, s: float = 0, flag: str = "true") -> str:
    lanes = "".join(lane(number, links=LINKS.replace('"-1"', f'"{number}"')) for number in numbers)
    return f'<laneSection s="{s}" singleSide="{flag}"><{side}>{lanes}</{side}></laneSection>'


SAME = {
    "a geometry of no length, anywhere": road(
        1, geometry(0, 0, 0, 0, 100.0) + geometry(100, 7.0, 8.0, 0, 0.0) + geometry(100, 100.0, 0, 0, 100.0)
    ),
    "geometries and sections out of order": road(
        1,
        geometry(100, 100.0, 0, 0, 100.0) + geometry(0, 0, 0, 0, 100.0),
        sections=section(s=90) + section(),
    ),
    "a section of no length that leads on": road(
        1,
        geometry(0, 0, 0),
        sections=section(lane(links=TO_2))
        + section(lane(-2, links=LINKS), lane(widths=WIDTH.replace("3.5", "0")), s=90)
        + section(lane(links=FROM_2), s=90.0),
    ),
    "a section of a tenth of a micrometre": road(
        1, geometry(0, 0, 0), sections=section() + section(s=90) + section(s="90.0000001")
    ),
    "a section of no length at the start": road(1, geometry(0, 0, 0), sections=section() + section(s=0)),
    "a section of no length at the end": road(1, geometry(0, 0, 0), sections=section() + section(s=200)),
    "two records at one place": road(1, geometry(0, 0, 0), sections=section(lane(widths=WIDTH + WIDTH))),
    "sections of one side": road(
        1,
        geometry(0, 0, 0),
        sections=single("left", 1) + single("right", -1) + single("left", 1, s=60) + single("right", -1, s=9),
    ),
    "sections of one side that do not say so": road(
        1, geometry(0, 0, 0), sections=single("left", 1, flag="false") + single("right", -1, flag="false")
    ),
    "a polynomial by length": road(1, polynomial(1, 'pRange="arcLength"')),
    "a polynomial in other letters": road(1, polynomial(200, 'pRange="Normalized"')),
    "no speed limit": road(1, geometry(0, 0, 0), before='<type s="0"><speed max="no limit"/></type>'),
    "a junction attribute without a value": road(1, geometry(0, 0, 0), attributes='junction=""'),
    "data of a program": road(1, geometry(0, 0, 0), before='<userData code="a"><vectorScene/></userData>'),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_what_says_the_same_in_other_words_is_the_same(tmp_path: Path, name: str) -> None:
    town, expected = town_from(tmp_path, ring(SAME[name])), town_from(tmp_path, ring())
    assert metres(town) >= metres(expected) - 1e-3
    assert set(kinds(town)) <= {"a link to a lane that is not there was passed over"}
    assert "road 1" in town.road_name


def test_a_lane_begins_where_its_first_width_does(tmp_path: Path) -> None:
    """As roadgen writes the lane of a ramp: its section goes on before it, without a width."""
    late = lane(-2, WIDTH.replace('"0"', '"60"', 1), "<link/>")
    text = with_lane(WIDTH, late)
    town = town_from(tmp_path, text)
    assert kinds(town) == ["a lane whose first width starts late was taken as 0 m wide before it"]
    assert metres(town) - metres(town_from(tmp_path, with_lane(WIDTH))) == pytest.approx(140.0, abs=1.0)
    with pytest.raises(MapError, match=r"starts late .+ \(60 m\)"):
        town_from(tmp_path, text, strict=True)
    with pytest.raises(MapError, match=r"its first <border> starts 60.000 m behind its section"):
        town_from(tmp_path, text.replace("width", "border"))


UNUSUAL = {
    "a rule in small letters": ring().replace('junction="-1"', 'junction="-1" rule="rht"'),
    "no coefficients": with_lane('<width sOffset="0" a="3.5"/>'),
    "no offset": with_lane('<width a="3.5" b="0" c="0" d="0"/>'),
    "a width that starts late": with_lane(WIDTH.replace('"0"', '"0.2"', 1)),
    "a section that starts late": ring(road(1, geometry(0, 0, 0), sections=section(s=0.2))),
    "a section behind the end": ring(road(1, geometry(0, 0, 0), sections=section() + section(s=200.2))),
    "a lane without a width": with_lane(WIDTH, lane(-2, "", links="<link/>")),
    "a link of a road that says nothing": ring(
        "", road(5, geometry(0, 0, -99, length=99.0), length=99, links="<successor/>")
    ),
    "a link to no end of a road": ring(
        "",
        road(
            5,
            geometry(0, 0, -99, length=99.0),
            length=99,
            links='<successor elementType="road" elementId="1"/>',
        ),
    ),
    "a link of a lane that says nothing": with_lane(
        WIDTH, lane(-2, WIDTH.replace("3.5", "0"), '<link><successor id=""/></link>')
    ),
    "a mark that does not exist": ring().replace(WIDTH, WIDTH + '<roadMark laneChange="maybe"/>'),
    "a limit of 0": with_speed('max="0" unit="km/h"'),
    "a limit without a number": with_speed('max="" unit="km/h"'),
    "a polynomial without its range, by length": ring(road(1, polynomial(1))),
    "a polynomial without its range, to 1": ring(road(1, polynomial(200))),
    "a road without a reference line": ring("", road(5, "<!-- none -->", links="<!-- none -->")),
    "a road without a length": ring("", road(5, geometry(0, 0, -9, 0, 0.0), length=0, links="<!-- -->")),
    "a road without lanes": ring("", road(5, geometry(0, 0, -99), sections="<!-- none -->")),
    "a length of rounding below 0": ring(road(1, geometry(0, 0, 0) + geometry(200, 200.0, 0, 0, -1e-9))),
    "a name that is not UTF-8": ring().replace('id="1"', 'id="1" name="Straße"').encode("latin-1"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNUSUAL)
def test_what_can_only_mean_one_thing_is_read_so_and_warned_of_but_strict_maps_are_refused(
    tmp_path: Path, name: str
) -> None:
    town = town_from(tmp_path, UNUSUAL[name])
    assert len(kinds(town)) in (1, 2)
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())), abs=0.1)
    with pytest.raises(MapError, match=r"line \d+: .+, but the map is read strictly"):
        town_from(tmp_path, UNUSUAL[name], strict=True)


@pytest.mark.parametrize(
    ("unit", "speed"),
    [("m/s", 50.0), ("km/h", 50 / 3.6), ("mph", 22.352), ("KM/H", 50 / 3.6), ("kmh", 50 / 3.6),
     ("kph", 50 / 3.6), ("Mph", 22.352), ("mps", 50.0), ("", 50.0)],
)  # fmt: skip
def test_units_of_speed_are_read_by_their_usual_names(tmp_path: Path, unit: str, speed: float) -> None:
    town = town_from(tmp_path, with_speed(f'max="50" unit="{unit}"'))
    on_road = [name == "road 1" for name in town.road_name]
    np.testing.assert_allclose(town.graph.speed_limit[on_road], speed)
    assert bool(town.findings) == (unit not in ("m/s", "km/h", "mph"))


def test_a_unit_that_means_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        MapError, match=r"road 1, line \d+: the speed's unit is 'furlongs', it must be one of"
    ):
        town_from(tmp_path, with_speed('max="50" unit="furlongs"'))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
def test_texts_may_have_any_encoding_that_they_name(tmp_path: Path, encoding: str) -> None:
    head = f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>'
    town = town_from(tmp_path, (head + ring().replace('id="1"', 'id="1" name="Straße"', 1)).encode(encoding))
    assert "Straße" in town.road_name
    assert town.findings == ()


@pytest.mark.parametrize("minor", [4, 5, 6, 7, 8])
def test_revisions_and_namespaces_make_no_difference(tmp_path: Path, minor: int) -> None:
    space = 'xmlns="http://code.asam.net/simulation/standard/opendrive_schema"'
    header = f'<header revMajor="1" revMinor="{minor}"><geoReference><![CDATA[+]]></geoReference></header>'
    town = town_from(tmp_path, ring().replace("<OpenDRIVE>", f"<OpenDRIVE {space}>{header}"))
    assert town.findings == ()
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())))


def test_a_side_that_has_sections_of_its_own_keeps_the_lanes_of_the_other(tmp_path: Path) -> None:
    sides = single("left", 1) + single("right", -1) + single("right", -1, s=60) + single("right", -1, s=90)
    sides = sides.replace('id="1"/><successor id="1"', 'id="1"/><successor id="2"')
    sides += single("left", 1, 2, s=120) + single("right", -1, s=120)
    path = tmp_path / "map.xodr"
    path.write_text(ring(road(1, geometry(0, 0, 0), sections=sides)))
    found = [
        (
            part.s,
            part.end,
            {number: (lane.predecessors, lane.successors) for number, lane in part.lanes.items()},
        )
        for part in read_opendrive(path).roads["1"].sections
    ]
    right = ([-1], [-1])
    assert found == [
        (0.0, 60.0, {1: ([1], [1]), -1: right}),
        (60.0, 90.0, {1: ([1], [1]), -1: right}),
        (90.0, 120.0, {1: ([1], [2]), -1: right}),
        (120.0, 200.0, {1: ([1], [1]), 2: ([2], [2]), -1: right}),
    ]


@pytest.fixture(scope="module", params=["map.xodr", "MAP.XODR", "Map.Xodr"])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("any case") / request.param
    place.write_text(ring(shift=(0.0, 0.1)))
    return place


def test_a_map_is_known_by_its_ending_in_any_case(path: Path) -> None:
    town: Town = load_town(path)
    assert town.name == path.stem
    assert load_town(str(path)) is town


def test_an_environment_bridges_small_faults_unless_its_maps_are_strict(path: Path) -> None:
    config = {"vehicles_count": 2}
    with gymnasium.make("athrl/OpenDrive-v0", map=str(path), config=config) as env:
        env.reset(seed=1)
    with pytest.raises(
        ValueError, match=r"a gap between linked lanes would be bridged \(0.100 m\), but the map is"
    ):
        gymnasium.make("athrl/OpenDrive-v0", map=str(path), config={**config, "strict_map": True})
    with pytest.raises(ValueError, match="the setting strict_map is 'yes', it should be False or True"):
        gymnasium.make("athrl/OpenDrive-v0", map=str(path), config={**config, "strict_map": "yes"})


def test_a_map_on_which_nothing_can_stand_is_refused_with_its_length(tmp_path: Path) -> None:
    text = (
        "<OpenDRIVE>" + road(1, geometry(0, 0, 0, 0, 10.0), length=10, links="<!-- none -->") + "</OpenDRIVE>"
    )
    with pytest.raises(MapError, match=r"^map.xodr: no lane is long enough to .+ 10.00 m, .+ 12 m$"):
        town_from(tmp_path, text)
