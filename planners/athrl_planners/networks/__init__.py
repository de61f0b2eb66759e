"""The networks that planners are made of: encoders, memory, heads."""

from athrl_planners.networks.encoders import make_encoder
from athrl_planners.networks.heads import Actor, ChoiceCritic, Critic
from athrl_planners.networks.memory import Lstm
from athrl_planners.networks.trunk import Trunk, as_pixels

__all__ = ["Actor", "ChoiceCritic", "Critic", "Lstm", "Trunk", "as_pixels", "make_encoder"]
