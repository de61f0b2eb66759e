"""A moment of an evaluated episode as a message for live viewing and recording."""

from __future__ import annotations

from athrl_protocol import Frame
from athrl_protocol.messages.frame import frame_of

from athrl_evaluator.scoring.drivers import BatchDriver
from athrl_evaluator.scoring.episodes import EpisodeStep


def frame_of_step(driver: BatchDriver, step: EpisodeStep) -> Frame:
    """Return the frame after a step."""
    return frame_of(
        step.environment.scene(),
        step.image,
        driver=driver.name,
        town=step.town,
        policy_version=driver.policy_version,
        episode_seed=step.seed,
        step=step.step,
        decision=step.decision,
        reward=step.reward,
        episode_return=step.episode_return,
    )
