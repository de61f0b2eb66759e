"""What is to be done in each environment of a batch: the work itself, actions, and where episodes begin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.route import PLAN_ROWS

START, BEGIN, TAKE, TICK, DRIVE, SEE, LOOK = 1, 2, 4, 8, 16, 32, 64
"""Work, to be added up: start an episode; begin a decision; take its action; drive one tick; drive all its
ticks or until the episode ends; draw the observation; find the ego's leader and its next junction."""

DECIDE = BEGIN + TAKE + DRIVE + SEE
"""A whole decision."""


class Orders(NamedTuple):
    """The work of E environments; those with none are left alone."""

    work: Integers
    """[E] see above."""
    actions: NDArray[np.float32]
    """[E, 2] as the kind of action takes them: within [-1, 1], or choices as whole numbers."""
    starts: Floats
    """[E, 4] where an episode starts: the ego's row of the lane graph, the metres along it, those along the
    last row of the plan where the destination is, and the way that is the whole of the episode, m."""
    seeds: NDArray[np.uint64]
    """[E, 2] of the route and of the traffic."""
    plans: Integers
    """[E, PLAN_ROWS] rows to drive, the first of them the start's."""
    plan_rows: Integers
    """[E] rows in the plan; 0 for random turns."""
    placed: Integers
    """[E] vehicles that found a place when the episode started, written by the kernel."""
    choices: Integers
    """[E, starting places] room for the kernel to work in."""


def new_orders(environments: int, starting_places: int) -> Orders:
    """No work for a number of environments."""
    count = environments
    return Orders(
        work=np.zeros(count, np.int64),
        actions=np.zeros((count, 2), np.float32),
        starts=np.zeros((count, 4)),
        seeds=np.zeros((count, 2), np.uint64),
        plans=np.zeros((count, PLAN_ROWS), np.int64),
        plan_rows=np.zeros(count, np.int64),
        placed=np.zeros(count, np.int64),
        choices=np.zeros((count, starting_places), np.int64),
    )
