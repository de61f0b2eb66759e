"""The policy artefact: the published policy as one ONNX file that says what it is.

Inputs: `image` uint8 [batch, height, width, channels], `motion` float32 [batch, motion], for each level L
`L_state` float32 [batch, state] (zeros at an episode's start), and for each level but the last `L_noise` and
`forced_L` float32 [batch, actions] in physical units (0: greedy; NaN: free). Outputs: each level's action L
and `next_L_state`. An action with noise or a forced one is put out as the level below saw it. The metadata
entry `athrl` is JSON.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto
from torch import Tensor

from athrl_planners.athrl import AtHRL
from athrl_planners.networks import Trunk
from athrl_planners.onnx_graph import OnnxGraph
from athrl_planners.policy import LevelPolicy

SCHEMA_VERSION = 1


class PolicyExporter:
    """Builds the graph once; each artefact is that graph with the weights of the moment."""

    def __init__(self, agent: AtHRL) -> None:
        self._policy = agent.policy
        graph = OnnxGraph()
        _build(graph, agent)
        self._weights = set(graph.weights)
        self._graph = _without(self._weights, graph.model({"athrl": json.dumps(policy_metadata(agent))}))

    def artefact(self) -> bytes:
        """The present policy as the bytes of an ONNX file.

        The weights go into a message of the moment: one that lives keeps all that was ever put into it.
        """
        state: dict[str, Tensor] = self._policy.state_dict()
        model = ModelProto.FromString(self._graph)
        for initializer in model.graph.initializer:
            if initializer.name in self._weights:
                weights = state[initializer.name].cpu().numpy()
                initializer.raw_data = weights.astype("<f4", copy=False).tobytes()
        return model.SerializeToString()


def _without(weights: set[str], model: ModelProto) -> bytes:
    """The model as bytes, with its weights left out."""
    for initializer in model.graph.initializer:
        if initializer.name in weights:
            initializer.ClearField("raw_data")
    return model.SerializeToString()


def policy_metadata(agent: AtHRL) -> dict[str, Any]:
    """What the artefact says about itself."""
    sizes = agent.level_sizes
    return {
        "schema_version": SCHEMA_VERSION,
        "planner": agent.kind,
        "observation": {
            "image": list(agent.observation.image_shape),
            "motion": list(agent.observation.motion_names),
        },
        "levels": [
            {
                "name": level,
                "state_size": sizes[level][1],
                "actions": [asdict(action) for action in agent.actions[level]],
            }
            for level in agent.levels
        ],
    }


def _build(graph: OnnxGraph, agent: AtHRL) -> None:
    """Write down what `PolicyNetwork.forward` does."""
    observation = agent.observation
    image = graph.input("image", TensorProto.UINT8, observation.image_shape)
    motion = graph.input("motion", TensorProto.FLOAT, (observation.motion_size,))
    pixels = graph.call("Transpose", graph.call("Cast", image, to=TensorProto.FLOAT), perm=[0, 3, 1, 2])
    pixels = graph.call("Mul", pixels, graph.constant(np.array(1 / 255, np.float32)))
    above: str | None = None
    for name in agent.levels:
        actions, state_size = agent.level_sizes[name]
        level = agent.policy.levels[name]
        assert isinstance(level, LevelPolicy)
        prefix = f"levels.{name}"
        state = graph.input(f"{name}_state", TensorProto.FLOAT, (state_size,))
        context, next_state = _trunk(graph, level.trunk, f"{prefix}.trunk", pixels, motion, state)
        seen = context if above is None else graph.call("Concat", context, above, axis=1)
        raw = graph.layer(level.actor.layers, f"{prefix}.actor.layers", seen)
        centre, half_range = (
            graph.constant(value.cpu().numpy()) for value in (level.centre, level.half_range)
        )
        action = graph.call("Add", centre, graph.call("Mul", half_range, graph.call("Tanh", raw)))
        if name != agent.levels[-1]:
            action = graph.call("Add", action, graph.input(f"{name}_noise", TensorProto.FLOAT, (actions,)))
            forced = graph.input(f"forced_{name}", TensorProto.FLOAT, (actions,))
            action = graph.call("Where", graph.call("IsNaN", forced), action, forced)
        above = graph.call("Div", graph.call("Sub", action, centre), half_range)
        above = graph.call("Clip", above, *(graph.constant(np.array(end, np.float32)) for end in (-1, 1)))
        graph.output(name, graph.call("Add", centre, graph.call("Mul", half_range, above)), (actions,))
        graph.output(f"next_{name}_state", next_state, (state_size,))


def _trunk(
    graph: OnnxGraph, trunk: Trunk, name: str, pixels: str, motion: str, state: str
) -> tuple[str, str]:
    """Context and next state, as `Trunk.features` and `Trunk.unroll` compute them."""
    seen = graph.call("Concat", graph.layer(trunk.encoder, f"{name}.encoder", pixels), motion, axis=1)
    features = graph.layer(trunk.dense, f"{name}.dense", seen)
    split = graph.constant(np.full(2, trunk.recurrent, np.int64))
    output, cell = graph.node("Split", state, split, outputs=2, axis=1)
    output, cell = graph.lstm_step(trunk.lstm, f"{name}.lstm", features, output, cell)
    context = graph.call("Concat", features, output, axis=1)
    return context, graph.call("Concat", output, cell, axis=1)
