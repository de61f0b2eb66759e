"""The work to do in each environment of a batch, with actions and the starts of episodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.route import PLAN_LANES

START, BEGIN, SET_ACTION, TICK, DRIVE, OBSERVE, FIND_LEADER = 1, 2, 4, 8, 16, 32, 64
"""Kinds of work, which can be added up: start an episode; begin a decision; set its action; drive one tick;
drive all of its ticks or until the episode ends; draw the observation; find the ego's leader and next
junction."""

DECIDE = BEGIN + SET_ACTION + DRIVE + OBSERVE
"""A whole decision."""


class WorkOrders(NamedTuple):
    """The work of E environments; an environment without work is not touched."""

    flags: Integers
    """[E] sums of the flags above."""
    actions: NDArray[np.float32]
    """[E, 2] in the form of the kind of action: within [-1, 1], or choices as whole numbers."""
    starts: Floats
    """[E, 4] the start of an episode: the ego's lane, metres along it, metres of the destination along the
    last lane of the plan, and the length of the whole route, m."""
    seeds: NDArray[np.uint64]
    """[E, 2] of the route and of the traffic."""
    plans: Integers
    """[E, PLAN_LANES] lanes to drive, the first of them the start's."""
    plan_lanes: Integers
    """[E] lanes in the plan; 0 for random turns."""
    placed: Integers
    """[E] vehicles that were placed when the episode started, written by the kernel."""
    choices: Integers
    """[E, starting places] working memory of the kernel."""


def new_orders(environments: int, starting_places: int) -> WorkOrders:
    """Orders without work for a number of environments."""
    count = environments
    return WorkOrders(
        flags=np.zeros(count, np.int64),
        actions=np.zeros((count, 2), np.float32),
        starts=np.zeros((count, 4)),
        seeds=np.zeros((count, 2), np.uint64),
        plans=np.zeros((count, PLAN_LANES), np.int64),
        plan_lanes=np.zeros(count, np.int64),
        placed=np.zeros(count, np.int64),
        choices=np.zeros((count, starting_places), np.int64),
    )
