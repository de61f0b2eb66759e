"""Files with oddities that programs write: read for what they mean, or refused in one line that is true."""

import codecs
import os
import re
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, Town, load_town

from driving.tests.faulty_maps import ARC, geometry, kinds, lane, metres, ring, road, town_from

OVER = "two roads lie on each other without a junction: vehicles drive through each other there"
OTHER_RANGE = "a paramPoly3 was read with the other pRange, with which it is as long as it says"


def alone(plan: str, length: object = 400, before: str = "", sections: str = "") -> str:
    """Return a road of a lane in each direction that begins and ends at the map's edge."""
    both = f"<left>{lane(1)}</left><right>{lane()}</right>"
    sections = sections or f'<laneSection s="0">{both}</laneSection>'
    return (
        f"<OpenDRIVE>{road(1, plan, length=length, links='-', before=before, sections=sections)}</OpenDRIVE>"
    )


def polynomial(speed: float, span: str) -> str:
    zeros = " ".join(f'{name}="0"' for name in ("aU", "cU", "dU", "aV", "bV", "cV", "dV"))
    return geometry(0, 0.0, 0.0, 0.0, 200.0, f'<paramPoly3 bU="{speed}" {zeros} pRange="{span}"/>')


def elevation(*records: tuple[float, float, float]) -> str:
    rows = "".join(f'<elevation s="{s}" a="{a}" b="{b}" c="0" d="0"/>' for s, a, b in records)
    return f"<elevationProfile>{rows}</elevationProfile>"


def refusal(folder: Path, text: str, strict: bool = False) -> str:
    with pytest.raises(MapError) as error:
        town_from(folder, text, strict)
    assert "\n" not in str(error.value)
    return str(error.value)


# Polynomials


@pytest.mark.parametrize(("speed", "span"), [(1, "normalized"), (200, "arcLength")])
def test_a_polynomial_is_as_long_as_it_says(tmp_path: Path, speed: float, span: str) -> None:
    """Otherwise a road of 200 m has lanes of 40 km, or ends after a metre."""
    text = ring(road(1, polynomial(speed, span)))
    town = town_from(tmp_path, text)
    assert kinds(town) == [OTHER_RANGE]
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())))
    assert "the map is read strictly" in refusal(tmp_path, text, strict=True)


@pytest.mark.parametrize(("speed", "runs"), [(0, "0.000"), (20, "20.000"), (20_000, "20000.000")])
def test_a_polynomial_of_quite_another_length_is_refused_with_both(
    tmp_path: Path, speed: float, runs: str
) -> None:
    said = refusal(tmp_path, ring(road(1, polynomial(speed, "normalized"))))
    assert said == f"map.xodr: road 1, line 4: its <paramPoly3> is {runs} m long, its length is 200.000 m"


def test_a_range_without_a_value_is_a_range_that_is_missing(tmp_path: Path) -> None:
    town = town_from(tmp_path, ring(road(1, polynomial(200, ""))))
    assert kinds(town) == ["a paramPoly3 without pRange was read by how fast its parameter runs"]


# What lies behind the end, and what belongs to nothing


def test_a_height_behind_the_end_of_its_road_holds_nowhere(tmp_path: Path) -> None:
    plan = geometry(0, 0.0, 0.0, 0.0, 400.0)
    text = alone(plan, before=elevation((0, 2, 0), (900, 50, 0)))
    town = town_from(tmp_path, text)
    assert kinds(town) == ["a height behind the end of its road was passed over"]
    assert set(town.graph.elevation) == {2.0}
    assert "be passed over (500 m), but the map is read strictly" in refusal(tmp_path, text, strict=True)
    town = town_from(tmp_path, alone(plan, before=elevation((0, 2, 0), (400, 50, 0))), strict=True)
    assert set(town.graph.elevation) == {2.0}
    town = town_from(tmp_path, alone(plan, before=elevation((900, 2, 0))))
    assert set(town.graph.elevation) == {2.0}


@pytest.mark.parametrize("junction", ["0", "none", "77"])
def test_a_road_of_a_junction_that_is_nowhere_is_an_ordinary_road(tmp_path: Path, junction: str) -> None:
    text = ring().replace('junction="-1"', f'junction="{junction}"')
    town, expected = town_from(tmp_path, text), town_from(tmp_path, ring().replace('"-1"', '" -1 "', 1))
    assert kinds(town) == ["a road of a junction that is not in the file was read as an ordinary road"]
    assert expected.findings == ()
    np.testing.assert_array_equal(town.graph.movement, expected.graph.movement)
    assert "the map is read strictly" in refusal(tmp_path, text, strict=True)


def test_a_file_in_which_no_road_has_a_line_is_not_said_to_have_no_road(tmp_path: Path) -> None:
    said = refusal(tmp_path, alone(""))
    assert said == "map.xodr: no <road> in the file has a reference line (<planView> with <geometry>)"
    assert refusal(tmp_path, "<OpenDRIVE/>") == "map.xodr: there is no <road> in the file"


# One road over itself, and two directions of one road


def helix(slope: float) -> str:
    plan = geometry(0, 30.0, 0.0, 0.0, 600.0, '<arc curvature="0.03"/>')
    return alone(plan, 600, elevation((0, 0, slope)))


def test_a_road_that_lies_on_itself_is_told_of_but_not_a_ramp_in_levels(tmp_path: Path) -> None:
    (found,) = town_from(tmp_path, helix(0.0)).findings
    assert (found.kind, found.place) == (OVER, "road 1 and itself, all lanes together")
    assert (found.metres or 0.0) > 1_000.0
    assert town_from(tmp_path, helix(0.05)).findings == ()


@pytest.mark.parametrize("at", [100, 200, 300])
@pytest.mark.parametrize("step", [1.75, -1.75, 3.0])
def test_two_directions_that_are_shifted_at_one_place_stay_beside_each_other(
    tmp_path: Path, at: float, step: float
) -> None:
    offset = f'<laneOffset s="{at}" a="{step}" b="0" c="0" d="0"/>'
    text = alone(geometry(0, 0.0, 0.0, 0.0, 400.0)).replace("<laneSection", f"{offset}<laneSection", 1)
    town = town_from(tmp_path, text)
    there, back = (
        np.concatenate([line for line, number in zip(town.lane_polylines(0.5), town.lane_id, strict=True)
                        if number == each])
        for each in (-1, 1)
    )  # fmt: skip
    distance = np.hypot(*(there[:, None] - back[None]).transpose(2, 0, 1)).min()
    assert distance == pytest.approx(3.5, abs=0.1)


# Files and names


def test_a_map_that_was_replaced_by_one_of_the_same_age_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "map.xodr"

    def written(text: str) -> Town:
        path.write_text(text)
        os.utime(path, ns=(10**18, 10**18))
        return load_town(path)

    first, second = written(ring()), written(ring().replace('"3.5"', '"3.0"'))
    assert (set(first.graph.width), set(second.graph.width)) == ({3.5}, {3.0})
    assert load_town(path) is second


def test_a_text_that_is_given_for_a_name_is_not_told_in_full() -> None:
    with pytest.raises(MapError, match=r"^there is no town named '<OpenDRIVE>.+\.\.\.'\. There are") as error:
        load_town(ring())
    assert len(str(error.value)) < 400


def test_a_map_too_high_for_the_picture_of_its_surface_is_named(tmp_path: Path) -> None:
    text = alone(geometry(0, 0.0, 0.0, 0.0, 400.0), before=elevation((0, 0, 20)))
    assert refusal(tmp_path, text) == (
        "map.xodr: its lanes lie from 0 to 8,000 m high, at most 6,000 m may be between them"
    )


# Forks in whole metres


def widening(lengths: tuple[int, int, int]) -> str:
    """Return a road whose one lane becomes two, which become one again, after so many metres each."""

    def linked(number: int, before: tuple[int, ...], after: tuple[int, ...]) -> str:
        links = "".join(f'<predecessor id="{each}"/>' for each in before)
        links += "".join(f'<successor id="{each}"/>' for each in after)
        return lane(number, links=links)

    places = np.cumsum([0, *lengths]).tolist()
    lanes = (linked(-1, (), (-1, -2)), linked(-1, (-1,), (-1,)) + linked(-2, (-1,), (-1,)))
    sections = "".join(
        f'<laneSection s="{s}"><right>{inside}</right></laneSection>'
        for s, inside in zip(places[:3], (*lanes, linked(-1, (-1, -2), ())), strict=True)
    )
    plan = geometry(0, 0.0, 0.0, 0.0, places[-1])
    return f"<OpenDRIVE>{road(1, plan, length=places[-1], links='-', sections=sections)}</OpenDRIVE>"


@pytest.mark.parametrize("lengths", [(40, 40, 40), (10, 40, 50), (60, 20, 60), (40, 41, 40)])
def test_lanes_that_fork_after_whole_metres_are_cut_nowhere_else(
    tmp_path: Path, lengths: tuple[int, int, int]
) -> None:
    """Where a lane ends just where the fork's junction does, a piece without length was cut from the next."""
    town = town_from(tmp_path, widening(lengths))
    assert town.graph.length.min() >= 1.0
    assert np.isfinite(town.graph.grade).all()


# Borders


def test_a_lane_given_by_borders_is_that_given_by_the_same_widths(tmp_path: Path) -> None:
    """It narrows from 3.5 m to nothing; where it is narrower than 2.2 m nobody drives."""
    shapes = {
        "width": ['<width sOffset="0" a="3" b="0" c="0" d="0"/>',
                  '<width sOffset="0" a="3.5" b="-0.00875" c="0" d="0"/>'],
        "border": ['<border sOffset="0" a="-3" b="0" c="0" d="0"/>',
                   '<border sOffset="0" a="-6.5" b="0.00875" c="0" d="0"/>'],
    }  # fmt: skip
    towns = []
    for shape in shapes.values():
        right = "".join(lane(-number, each) for number, each in enumerate(shape, 1))
        sections = f'<laneSection s="0"><right>{right}</right></laneSection>'
        towns.append(town_from(tmp_path, alone(geometry(0, 0.0, 0.0, 0.0, 400.0), sections=sections)))
    first, second = (town.graph for town in towns)
    assert first.width.min() > 2.2
    for name in ("length", "width", "start_x", "start_y"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), atol=1e-9)


# Texts


def test_elements_of_other_namespaces_are_no_opendrive(tmp_path: Path) -> None:
    foreign = '<x:left xmlns:x="urn:other"><x:lane id="-1"/></x:left><x:right xmlns:x="urn:other"/>'
    town = town_from(tmp_path, ring().replace("<right>", f"{foreign}<right>", 1))
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())))


def test_a_mark_of_utf8_before_latin1_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "map.xodr"
    text = ring().replace("<OpenDRIVE>", '<OpenDRIVE><header name="Straße"/>')
    path.write_bytes(codecs.BOM_UTF8 + text.encode("latin-1"))
    assert metres(load_town(path)) == pytest.approx(metres(town_from(tmp_path, ring())))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (ring().encode("utf-32"), "map.xodr: line 1: it is encoded in UTF-32, it must be in UTF-8 or UTF-16"),
        (
            ring().replace("<OpenDRIVE>", "<OpenDRIVE>\n&nbsp;").encode(),
            "map.xodr: line 2: this is not well-formed XML: the entity &nbsp; is not defined",
        ),
    ],
)
def test_a_text_that_no_parser_reads_is_refused_with_its_reason(
    tmp_path: Path, text: bytes, told: str
) -> None:
    path = tmp_path / "map.xodr"
    path.write_bytes(text)
    with pytest.raises(MapError) as error:
        load_town(path)
    assert str(error.value) == told


@pytest.mark.parametrize("number", ["4_0", "４０"])
def test_numbers_are_those_of_xml_and_not_of_python(tmp_path: Path, number: str) -> None:
    said = refusal(tmp_path, ring().replace('length="', f'length="{number}" was="', 1))
    assert f"length of <road> is {number!r}, it must be a number" in said


def test_a_spiral_turns_by_the_mean_of_its_curvatures(tmp_path: Path) -> None:
    """From 0 to 1.2 / m over 300 m it turns by 180 rad; at its largest curvature it would by 360."""

    def spiral(end: float) -> str:
        shape = f'<spiral curvStart="0" curvEnd="{end}"/>'
        return alone(geometry(0, 0.0, 0.0, 0.0, 300.0, shape), length=300)

    town_from(tmp_path, spiral(1.2))
    assert "its <spiral> turns by up to 210 rad" in refusal(tmp_path, spiral(1.4))


def test_what_is_no_map_on_the_disk_is_not_said_to_be_a_town(tmp_path: Path) -> None:
    (tmp_path / "ring.xml").write_text(ring())
    for path, told in ((tmp_path, "is a folder, should be"), (tmp_path / "ring.xml", "ends in .xodr")):
        with pytest.raises(MapError, match=f"^{re.escape(str(path))}: .*{told}"):
            load_town(path)


def test_roads_that_only_meet_end_to_end_do_not_lie_on_each_other(tmp_path: Path) -> None:
    """An arc goes on where a line ends, and no link says so."""
    line, arc = geometry(0, 0.0, 0.0, 0.0, 101.0), geometry(0, 101.0, 0.0, 0.0, 60.0, ARC)
    both = "".join(
        road(n, plan, length=metres, links="-") for n, plan, metres in ((1, line, 101), (2, arc, 60))
    )
    assert OVER not in kinds(town_from(tmp_path, f"<OpenDRIVE>{both}</OpenDRIVE>"))
