"""Checks the graph of a policy before ONNX Runtime sees it: what it may compute, and how much of it."""

from athrl_driving.policy.graph.checks import GraphCheck
from athrl_driving.policy.graph.operators import OPERATORS

__all__ = ["OPERATORS", "GraphCheck"]
