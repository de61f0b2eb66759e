"""Where roads enter and leave a map: the open ends of a map that was cut out of a larger one.

A road leaves the map where its lanes end and nothing follows any of them. Where one of them goes on, the
others end beside it and their vehicles change to it. Where a road enters the map is found in the same way.
"""

Edges = list[list[int]]
Pairs = list[tuple[int, int]]


def open_ends(lanes: int, ahead: Edges, pairs: Pairs) -> tuple[list[int], list[int]]:
    """Return the lanes on which roads enter the map, and those on which they leave it.

    The first `lanes` nodes of the graph are lanes, the others movements; `ahead` is what follows each node,
    `pairs` are (left, right) lanes beside each other, from left to right in every carriageway.
    """
    goes_on = [bool(targets) for targets in ahead]
    comes_from = [False] * len(ahead)
    for targets in ahead:
        for target in targets:
            comes_from[target] = True
    for flags in (goes_on, comes_from):
        _spread(flags, pairs)
    return (
        [lane for lane in range(lanes) if not comes_from[lane]],
        [lane for lane in range(lanes) if not goes_on[lane]],
    )


def _spread(flags: list[bool], pairs: Pairs) -> None:
    """Set the flag of every lane that has a lane with the flag in its row of neighbours."""
    for left, right in pairs:
        flags[right] |= flags[left]
    for left, right in reversed(pairs):
        flags[left] |= flags[right]
