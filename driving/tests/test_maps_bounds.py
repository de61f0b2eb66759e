"""A map of any content is refused in one line before it takes much time or memory."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path

import pytest
from athrl_driving.maps import MapError, load_town
from athrl_driving.maps.opendrive import bounds, read_opendrive

HEAD = '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>'
LANE = '<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="-1"/></link><width sOffset="0" a="3.5" b="0" c="0" d="0"/>{inside}</lane>'  # noqa: E501
ROAD = (
    '<road id="{id}" length="{length}" junction="-1" name="r"><link><successor elementType="road" '
    'elementId="{id}" contactPoint="start"/><predecessor elementType="road" elementId="{id}" '
    'contactPoint="end"/></link><planView>{plan}</planView><lanes>{offset}<laneSection s="0">'
    "<right>{lanes}</right></laneSection></lanes></road>"
)
CIRCLE = 314.1592653589793


def geometry(shape: str, length: object = CIRCLE, x: object = 0, s: object = 0, heading: object = 0) -> str:
    place = f's="{s}" x="{x}" y="0" hdg="{heading}" length="{length}"'
    return f"<geometry {place}>{shape}</geometry>"


def road(plan: str = geometry('<arc curvature="0.02"/>'), length: object = CIRCLE, **parts: object) -> str:
    given = {"id": "1", "offset": "", "lanes": LANE.format(inside="")} | parts
    return ROAD.format(length=length, plan=plan, **given)


def opendrive(*parts: str, head: str = HEAD) -> str:
    return head + "".join(parts) + "</OpenDRIVE>"


def refusal(folder: Path, content: str | bytes) -> str:
    """Return the one line with which a file is refused; nothing else is said."""
    path = folder / "some.xodr"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(MapError) as caught:
            load_town(path)
    (line,) = str(caught.value).splitlines()
    assert "some.xodr: " in line
    assert len(line) < 500
    return line


def test_the_ring_that_all_others_here_are_made_of_is_a_town(tmp_path: Path) -> None:
    path = tmp_path / "ring.xodr"
    path.write_text(opendrive(road()))
    assert load_town(path).lane_kilometres == pytest.approx(0.314, abs=0.001)


@pytest.mark.parametrize(
    ("shape", "length", "said"),
    [
        ('<arc curvature="1.0"/>', 1e7, "it must be from -200,000 to 200,000"),
        ('<arc curvature="1.0"/>', 1e5, "its <arc> turns by up to 100,000 rad, at most 200 may be"),
        ('<arc curvature="1e12"/>', 300, "its <arc> turns by up to"),
        ('<spiral curvStart="0" curvEnd="1e9"/>', 300, "its <spiral> turns by up to"),
        ('<poly3 a="0" b="1e12" c="1e12" d="1e12"/>', 300, "out of range|kink|it ends 300.000 m from"),
        ('<paramPoly3 aU="0" bU="1e9" cU="1e9" dU="1e9" aV="0" bV="-1e9" cV="1e9" dV="0"/>', 300, "pieces"),
        ('<arc curvature="1e400"/>', 300, "is '1e400', it must be a number"),
        ('<arc curvature="nan"/>', 300, "is 'nan', it must be a number"),
        ("<line/>", "inf", "is 'inf', it must be a number"),
        ("<line/>", -1, "must not be negative"),
        ("<line/>", "9" * 5001, "must be printable text of at most 256 characters"),
    ],
)  # fmt: skip
def test_a_line_without_end_or_without_measure_is_refused(
    tmp_path: Path, shape: str, length: object, said: str
) -> None:
    line = refusal(tmp_path, opendrive(road(geometry(shape, length), length)))
    assert any(part in line for part in said.split("|")), line


def test_a_geometry_that_turns_far_beyond_its_own_length_is_refused(tmp_path: Path) -> None:
    short = geometry('<spiral curvStart="0" curvEnd="1e5"/>', 1e-3) + geometry("<line/>", 1e5, s=1e5)
    assert "turns by up to" in refusal(tmp_path, opendrive(road(short, 2e5)))


@pytest.mark.parametrize("place", ["x", "s", "heading"])
@pytest.mark.parametrize("value", ["1e300", "-1e300", "1e13"])
def test_a_number_that_no_map_has_is_refused(tmp_path: Path, place: str, value: str) -> None:
    line = refusal(tmp_path, opendrive(road(geometry('<arc curvature="0.02"/>', **{place: value}))))
    assert f"is '{value}', it must be from" in line


def test_a_ring_around_a_country_is_refused(tmp_path: Path) -> None:
    radius, half = 60_000.0, 60_000.0 * math.pi
    arc = f'<arc curvature="{1 / radius!r}"/>'
    back = geometry(arc, half).replace('y="0" hdg="0"', f'y="{2 * radius!r}" hdg="{math.pi!r}"')
    halves = [road(geometry(arc, half), half), road(back, half, id="2")]
    ring = "".join(
        part.replace('elementId="1"', 'elementId="0"')
        .replace('elementId="2"', 'elementId="1"')
        .replace('elementId="0"', 'elementId="2"')
        for part in halves
    )
    assert "the lanes lie on 120 x 120 km, at most 4,096 km2 are allowed" in refusal(
        tmp_path, opendrive(ring)
    )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not well-formed XML"),
        (b" " * 11_000_000, "not well-formed XML"),
        (b"\0" * 100, "not well-formed XML"),
        (opendrive(" " * 11_000_000), "not well-formed XML"),
        ("<a>" * 1_000, "not well-formed XML"),
        (opendrive("<a>" * 10_000 + "</a>" * 10_000), "not well-formed XML"),
        (opendrive(road(), "<a/>" * (2 * bounds.MOST_ELEMENTS + 1)), "too many XML elements"),
        (opendrive(road(), "<a " + "=" * (bounds.MOST_ATTRIBUTES + 1) + "/>"), "too many XML attributes"),
        (b" " * (bounds.LARGEST_FILE + 1), "is too large: should have at most 67,108,864 bytes"),
        ("<OpenDRIVE/>", "there is no <road>"),
        ("<OpenSCENARIO><road/></OpenSCENARIO>", "the root is <OpenSCENARIO>"),
        (opendrive(road(id="1&#10;2")), "must be printable text"),
        (opendrive(road(lanes=LANE.replace('"-1" type', '"-99999999999999999999" type').format(inside=""))),
         "it must be a whole number"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_map_is_refused(tmp_path: Path, content: str | bytes, said: str) -> None:
    assert said in refusal(tmp_path, content)


def test_entities_do_not_unfold(tmp_path: Path) -> None:
    lines = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 12))
    kind = f'<!DOCTYPE OpenDRIVE [<!ENTITY l0 "lol">{lines}<!ENTITY file SYSTEM "file:///etc/passwd">]>'
    for inside in ("&l11;", "&file;", '<userData code="&l11;"/>', ""):
        line = refusal(tmp_path, f"{kind}<OpenDRIVE>{inside}{road()}</OpenDRIVE>")
        assert "document type" in line or "amplification" in line


def test_a_document_type_without_entities_is_passed_over(tmp_path: Path) -> None:
    """As files of the first revisions have it; nothing is fetched."""
    path = tmp_path / "old.xodr"
    path.write_text(f'<!DOCTYPE OpenDRIVE SYSTEM "OpenDRIVE.dtd"><OpenDRIVE>{road()}</OpenDRIVE>')
    assert list(read_opendrive(path).roads)


def many_lanes() -> str:
    return "".join(LANE.format(inside="").replace('id="-1" type', f'id="-{n}" type') for n in range(1, 202))


def diamonds(count: int) -> str:
    """Return junctions in a row, with two short roads from each to the next: 2^count ways."""
    parts = [straight("in", 0, 100, after="j0"), straight("out", 100 + 4 * count, 100)]
    before = ["in"]
    for n in range(count + 1):
        following = [f"a{n}", f"b{n}"] if n < count else ["out"]
        if n < count:
            parts += [straight(name, 100 + 4 * n, 4, f"j{n}", after=f"j{n + 1}") for name in following]
        connections = "".join(
            f'<connection incomingRoad="{a}" connectingRoad="{b}" contactPoint="start"><laneLink from="-1" '
            'to="-1"/></connection>'
            for a in before
            for b in following
        )
        parts.append(f'<junction id="j{n}">{connections}</junction>')
        before = following
    return "".join(parts)


def straight(name: str, x: float, length: float, junction: str = "-1", after: str = "") -> str:
    link = f'<successor elementType="junction" elementId="{after}"/>' if after else ""
    lane = LANE.format(inside="").replace('<predecessor id="-1"/><successor id="-1"/>', "")
    return (
        f'<road id="{name}" length="{length}" junction="{junction}"><link>{link}</link><planView>'
        f"{geometry('<line/>', length, x)}</planView><lanes><laneSection s='0'><right>{lane}</right>"
        "</laneSection></lanes></road>"
    )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (road(lanes=many_lanes()), "201 lanes, at most 200"),
        (road(lanes=LANE.replace("</link>", '<successor id="-1"/>' * 201 + "</link>").format(inside="")),
         "linked to more than 200 lanes"),
        ("".join(road(geometry('<arc curvature="0.001"/>', 199_000), 199_000, id=n,
                      offset='<laneOffset s="0" a="0" b="1e-9" c="0" d="0"/>') for n in range(40)),
         "would have too many pieces"),
        (diamonds(30), "too many ways lead through junctions"),
    ],
    ids=["lanes beside", "links", "pieces", "ways"],
)  # fmt: skip
def test_a_small_file_that_grows_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, said: str
) -> None:
    monkeypatch.setattr("athrl_driving.maps.opendrive.model.MOST_PIECES", 5_000)
    monkeypatch.setattr("athrl_driving.maps.standing_segments.MOST_PATHS", 10_000)
    assert said in refusal(tmp_path, opendrive(content))


def test_a_path_with_a_nul_or_of_a_pipe_is_refused(tmp_path: Path) -> None:
    for name in ("a\0b.xodr", "~nobody-of-that-name/b.xodr"):
        with pytest.raises(MapError, match="there is no such file"):
            load_town(name)
    os.mkfifo(tmp_path / "pipe.xodr")
    with pytest.raises(MapError, match="is a pipe, socket or device, should be a file"):
        load_town(tmp_path / "pipe.xodr")
    (tmp_path / "folder.xodr").mkdir()
    with pytest.raises(MapError, match="is a folder"):
        load_town(tmp_path / "folder.xodr")


def test_roads_that_cross_in_very_many_places_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("athrl_driving.maps.crossings.MOST_CROSSINGS", 5)
    rings = [road(geometry('<arc curvature="0.02"/>', x=10 * n), id=n) for n in range(10)]
    assert "places where lanes cross outside junctions, at most 5" in refusal(tmp_path, opendrive(*rings))


def test_a_road_that_is_in_the_file_very_often_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("athrl_driving.maps.lying_over.MOST_LYING_OVER", 1_000)
    said = refusal(tmp_path, opendrive(*(road(id=n) for n in range(10))))
    assert "pairs of parts of lanes lie on each other, at most 1,000" in said
