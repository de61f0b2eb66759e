"""Attributes of XML elements as numbers, with errors that name the place in the file."""

import math
from collections.abc import Iterator

from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.findings import Findings
from athrl_driving.maps.opendrive.bounds import GAP, LARGEST_ID, LARGEST_NUMBER, LONGEST_ROAD, LONGEST_TEXT
from athrl_driving.maps.opendrive.model import Cubic, MapError, SpeedLimit

LONGEST_MESSAGE = 300
"""Characters of an error, which may quote the file."""

WITHOUT_LIMIT = 130.0 / 3.6
"""m/s, where the file says "no limit": what German motorways without one recommend."""

_SPEED_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_UNITS_IN_USE = {"": "m/s", "mps": "m/s", "kmh": "km/h", "kph": "km/h", "kmph": "km/h", "mi/h": "mph"}
"""Units of speed as some files write them, in lower case, and as the standard does."""


class ElementReader:
    """Attributes of elements as numbers; errors name the file, the road, the lane and the line."""

    def __init__(self, name: str, findings: Findings) -> None:
        self.name = name
        self.findings = findings
        self.road = ""
        self.lane: int | None = None

    def error(self, element: etree._Element, message: str) -> MapError:
        """Return the error for an element's place."""
        if len(message) > LONGEST_MESSAGE:
            message = f"{message[: LONGEST_MESSAGE - 3]}..."
        return MapError(f"{self.name}: {self.place(element)}: {message}")

    def note(self, element: etree._Element, kind: str, metres: float | None = None) -> None:
        """Note a fault at an element's place. Raises `MapError` where the file is read strictly."""
        self.findings.add(kind, self.place(element), metres)

    def place(self, element: etree._Element) -> str:
        """Return where an element is: its road, lane and line."""
        places = [f"road {self.road}"] if self.road else []
        if self.lane is not None:
            places.append(f"lane {self.lane}")
        return ", ".join([*places, f"line {element.sourceline}"])

    def text(self, element: etree._Element, attribute: str) -> str:
        """Return a required attribute."""
        value = element.get(attribute)
        if value is None:
            raise self.error(element, f"<{element.tag}> has no attribute {attribute!r}")
        if len(value) > LONGEST_TEXT or not value.isprintable():
            message = (
                f"{attribute} of <{element.tag}> must be printable text of at most {LONGEST_TEXT} characters"
            )
            raise self.error(element, message)
        return str(value)

    def number(self, element: etree._Element, attribute: str, most: float = LARGEST_NUMBER) -> float:
        """Return an attribute as a finite number from -`most` to `most`."""
        text = self.text(element, attribute)
        try:
            value = float(_plain(text))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(element, f"{attribute} of <{element.tag}> is {text!r}, it must be a number")
        if abs(value) > most:
            bounds = f"-{most:,.0f} to {most:,.0f}"
            raise self.error(element, f"{attribute} of <{element.tag}> is {text!r}, it must be from {bounds}")
        return value

    def station(self, element: etree._Element, attribute: str) -> float:
        """Return an attribute as metres along a road."""
        return self.number(element, attribute, LONGEST_ROAD)

    def length(self, element: etree._Element) -> float:
        """Return the length of a road or a geometry."""
        length = self.station(element, "length")
        if -GAP <= length < 0.0:
            self.note(element, "a length below 0 was taken as 0", -length)
            return 0.0
        if length < 0.0:
            raise self.error(element, f"length of <{element.tag}> is {length:g}, it must not be negative")
        return length

    def whole(self, element: etree._Element, attribute: str) -> int:
        """Return an attribute as a whole number."""
        text = self.text(element, attribute)
        try:
            value = int(_plain(text))
        except ValueError:
            value = LARGEST_ID + 1
        if abs(value) > LARGEST_ID:
            raise self.error(
                element, f"{attribute} of <{element.tag}> is {text!r}, it must be a whole number"
            )
        return value

    def cubics(self, elements: Iterator[etree._Element], station: str, begin: float) -> list[Cubic]:
        """Return polynomials in order; `station` is the attribute with their start, from `begin` on."""
        records = [
            Cubic(
                s=begin + self.offset(element, station),
                a=self.number(element, "a"),
                b=self._coefficient(element, "b"),
                c=self._coefficient(element, "c"),
                d=self._coefficient(element, "d"),
                line=element.sourceline or 0,
            )
            for element in elements
        ]
        return sorted(records, key=lambda record: record.s)

    def speed(self, element: etree._Element, start: float) -> SpeedLimit:
        """Return the speed limit that holds from station `start` on."""
        if element.get("max") == "no limit":
            return SpeedLimit(start, WITHOUT_LIMIT)
        if element.get("max") == "undefined":
            return SpeedLimit(start, None)
        if not element.get("max"):
            self.note(element, "a speed limit without a number was passed over")
            return SpeedLimit(start, None)
        unit = element.get("unit", "m/s")
        if unit not in _SPEED_UNITS:
            unit = self._usual_unit(element, unit)
        limit = self.number(element, "max") * _SPEED_UNITS[unit]
        if limit <= 0.0:
            self.note(element, "a speed limit that is not above 0 was taken as none")
            return SpeedLimit(start, None)
        return SpeedLimit(start, limit)

    def offset(self, element: etree._Element, attribute: str = "sOffset") -> float:
        """Return how many metres behind its parent's start an element begins; 0 where it does not say."""
        if element.get(attribute) is None:
            self.note(element, "an element that does not say where it begins was taken to begin at 0 m")
            return 0.0
        return self.station(element, attribute)

    def _coefficient(self, element: etree._Element, attribute: str) -> float:
        if element.get(attribute) is None:
            self.note(element, "a coefficient that is missing was taken as 0")
            return 0.0
        return self.number(element, attribute)

    def _usual_unit(self, element: etree._Element, unit: str) -> str:
        usual = unit.strip().lower()
        usual = _UNITS_IN_USE.get(usual, usual)
        if usual not in _SPEED_UNITS:
            raise self.error(element, f"the speed's unit is {unit!r}, it must be one of m/s, km/h, mph")
        self.note(element, "a unit of speed that does not exist was read as the one it is like")
        return usual


def _plain(text: str) -> str:
    """Return the text of a number. Raises `ValueError` for what Python reads as one and XML does not."""
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return text
