"""One decision as one compiled call: controllers, ego, traffic, collision, route, reward, metrics, image."""

from athrl_driving.episode.beginning import begin, clear_decision
from athrl_driving.episode.decision import take
from athrl_driving.episode.motion import note_motion
from athrl_driving.episode.recording_buffer import record
from athrl_driving.episode.state import DriveSettings, EpisodeState, Progress, Views
from athrl_driving.episode.tick import tick
from athrl_driving.episode.work_flags import (
    BEGIN,
    DRIVE,
    FIND_LEADER,
    OBSERVE,
    SET_ACTION,
    START,
    TICK,
    WorkOrders,
)
from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry, part
from athrl_driving.metrics import environment_metrics
from athrl_driving.perception import draw_surroundings
from athrl_driving.route import environment_route
from athrl_driving.traffic.state import environment_traffic
from athrl_driving.traffic.tick import find_leader


@entry
def drive(state: EpisodeState, orders: WorkOrders, first: int, last: int) -> None:
    """Do the work of `orders` in the environments `first` to `last` - 1; both tuples are pinned.

    Environments share no writable state, so calls for different ones may run at the same time.
    """
    progress = state.progress
    for e in range(first, last):
        work = orders.flags[e]
        if work == 0:
            continue
        own = Views(
            environment_traffic(state.traffic, e),
            environment_route(state.routes, e),
            environment_metrics(state.metrics, e),
        )
        views = by_reference(own)
        if work & START:
            begin(views, state.settings, progress, orders, e)
        _decide(views, state.settings, progress, orders, e)
        if work & OBSERVE:
            ego, env_index = progress.ego[e], state.observations.env_index[e]
            image, motion = state.observations.images[env_index], state.observations.motion[env_index]
            draw_surroundings(state.perception, views.traffic, views.route, ego, image, progress.lidar[e])
            note_motion(ego, progress.control[e], motion)
            reward, terms = progress.reward[e], progress.terms[e]
            buffer, decisions = state.observations.recording_buffer, progress.decisions[e]
            record(buffer, env_index, decisions, motion, reward, terms)
        if work & FIND_LEADER:
            find_leader(views.traffic, progress.ego[e], progress.path[e])


@part
def _decide(views: Views, settings: DriveSettings, progress: Progress, orders: WorkOrders, e: int) -> None:
    """Carry out the part of the orders that concerns a decision."""
    work = orders.flags[e]
    if work & BEGIN:
        clear_decision(progress, e)
        progress.decisions[e] += 1
    if work & SET_ACTION:
        take(settings, progress.ego[e], progress.control[e], orders.actions[e])
    if work & (TICK + DRIVE):
        ticks = settings.ticks_per_decision if work & DRIVE else 1
        for _ in range(ticks):
            tick(views, settings, progress, e)
            if progress.terminated[e] or progress.truncated[e]:
                break
