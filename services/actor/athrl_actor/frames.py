"""A moment of an actor's first environment as a message for live viewing."""

from __future__ import annotations

from athrl_protocol import Frame
from athrl_protocol.messages.frame import frame_of

from athrl_actor.rollout import Moment


def frame_of_moment(moment: Moment) -> Frame:
    """Return the frame of a moment."""
    return frame_of(
        moment.environment.scene(),
        moment.image,
        driver="policy",
        town=moment.town,
        policy_version=moment.policy_version,
        episode_seed=moment.episode_seed,
        step=moment.step,
        decision=moment.decision,
        reward=moment.reward,
        episode_return=moment.episode_return,
    )
