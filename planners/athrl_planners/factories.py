"""Makes an agent and its replay from a planner's name and settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from athrl_spaces import Limits, Observation

from athrl_planners.registry import planner
from athrl_planners.replay import SequenceReplay
from athrl_planners.training.agent import Agent


def make_agent(
    kind: str,
    values: Mapping[str, Any] | None = None,
    *,
    observation: Observation | None = None,
    limits: Limits | None = None,
    seed: int = 0,
    device: str | torch.device = "cpu",
    burn_in: int = 0,
    precision: torch.dtype = torch.float32,
    threads: int = 1,
) -> Agent:
    """A new agent of a kind of planner.

    Args:
        kind: of the planner.
        values: settings that differ from the defaults.
        observation: its observation; by default images of 32 x 32.
        limits: limits of its decisions in environments.
        seed: of networks and noise.
        device: device of training.
        burn_in: first decisions of a sequence, which only update the recurrent state.
        precision: of updates.
        threads: threads that compute parts of an update in parallel.

    Raises:
        UnknownPlanner: there is no such kind.
        pydantic.ValidationError: a setting is not valid.
    """
    found = planner(kind)
    return Agent(
        found,
        found.read_settings(values or {}),
        observation or Observation(32),
        limits or Limits(),
        seed,
        device,
        burn_in=burn_in,
        precision=precision,
        threads=threads,
    )


def make_replay(
    agent: Agent,
    capacity: int,
    sequence_length: int,
    seed: int,
    priority: tuple[float, float] | None = None,
) -> SequenceReplay:
    """An empty replay for an agent: of whole sequences if it has a memory, else of single decisions."""
    return SequenceReplay(
        capacity,
        sequence_length,
        agent.description.observation,
        agent.description.levels,
        seed,
        horizons=() if agent.has_memory else agent.prepare.horizons,
        priority=priority,
    )
