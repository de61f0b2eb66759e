"""The policy artefact: the published policy as one ONNX file with its description.

Inputs are `image` uint8 [batch, height, width, channels] and `motion` float32 [batch, motion]; for each
level L `L_state` float32 [batch, state] if it has a state (zeros at an episode's start), `L_noise` float32
[batch, n] if it decides numbers (0: greedy), and `forced_L` float32 [batch, n] (NaN: free). Outputs are
each level's decision L and `next_L_state`. The metadata entry `athrl` is a `PolicyDescription` as JSON.
"""

from __future__ import annotations

import io
import warnings

import onnx
import torch
from athrl_spaces.policy import METADATA_KEY
from onnx import ModelProto
from torch import Tensor, nn

from athrl_planners.training.agent import Agent
from athrl_planners.training.policy import PolicyNetwork

OPSET = 17  # the first with LayerNormalization


class PolicyExporter:
    """Exports the graph once; each artefact is that graph with the current weights."""

    def __init__(self, agent: Agent) -> None:
        self._policy = agent.policy
        self._names, graph = _export(agent)
        self._graph = _without_weights(set(self._names), graph)

    def artefact(self) -> bytes:
        """The current policy as the bytes of an ONNX file.

        The weights go into a temporary message: protobuf never frees the fields of a message that is kept.
        """
        state = self._policy.state_dict()
        model = ModelProto.FromString(self._graph)
        for initializer in model.graph.initializer:
            if initializer.name in self._names:
                weights = state[self._names[initializer.name]].detach().cpu().contiguous().numpy()
                initializer.raw_data = weights.astype("<f4", copy=False).tobytes()
        return model.SerializeToString()


class _Flat(nn.Module):
    """The policy with flat lists of inputs and outputs, as a graph has them."""

    def __init__(self, policy: PolicyNetwork, inputs: list[tuple[str, str]], outputs: list[tuple[str, str]]):
        super().__init__()
        self.policy = policy
        self._inputs, self._outputs = inputs, outputs

    def forward(self, image: Tensor, motion: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        given: dict[str, dict[str, Tensor]] = {"state": {}, "noise": {}, "forced": {}}
        for (what, level), value in zip(self._inputs, rest, strict=True):
            given[what][level] = value
        output = self.policy(image, motion, given["state"], given["noise"], given["forced"])
        results = {"action": output.actions, "state": output.states}
        return tuple(results[what][level] for what, level in self._outputs)


def _export(agent: Agent) -> tuple[dict[str, str], ModelProto]:
    """The checked graph, and for each of its weights the name in the policy's state."""
    levels = agent.description.levels
    inputs, names, sizes = [], [], []
    for level, trained in zip(levels, agent.state.levels, strict=True):
        if level.state_size:
            inputs.append(("state", level.name))
            names.append(f"{level.name}_state")
            sizes.append(level.state_size)
        if trained.rule.takes_noise:
            inputs.append(("noise", level.name))
            names.append(f"{level.name}_noise")
            sizes.append(level.action_size)
        inputs.append(("forced", level.name))
        names.append(f"forced_{level.name}")
        sizes.append(level.action_size)
    outputs = [("action", level.name) for level in levels]
    outputs += [("state", level.name) for level in levels if level.state_size]
    output_names = [name if what == "action" else f"next_{name}_state" for what, name in outputs]
    observation = agent.description.observation
    image = torch.zeros((2, *observation.image_shape), dtype=torch.uint8, device=agent.device)
    motion = torch.zeros((2, observation.motion_size), device=agent.device)
    rest = [torch.zeros((2, size), device=agent.device) for size in sizes]
    file = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # The exporter by tracing: it starts in a tenth of a second, the newer one in several seconds. In
        # training mode, since otherwise it merges weights that happen to be equal, as those of all new
        # normalisations are. For these networks the modes do not differ otherwise.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Flat(agent.policy, inputs, outputs).train(),
            (image, motion, *rest),
            file,  # type: ignore[arg-type]  # tracing takes files, the newer exporter does not
            input_names=["image", "motion", *names],
            output_names=output_names,
            dynamic_axes={name: {0: "batch"} for name in ("image", "motion", *names, *output_names)},
            opset_version=OPSET,
            do_constant_folding=False,
            training=torch.onnx.TrainingMode.TRAINING,
            dynamo=False,
        )
    model = onnx.load_from_string(file.getvalue())
    onnx.helper.set_model_props(model, {METADATA_KEY: agent.description.to_json()})
    model.producer_name = "athrl"
    onnx.checker.check_model(model, full_check=True)
    state = agent.policy.state_dict()
    weights = {
        initializer.name: initializer.name.removeprefix("policy.")
        for initializer in model.graph.initializer
        if initializer.name.removeprefix("policy.") in state
    }
    missing = set(state) - set(weights.values())
    if missing:
        raise RuntimeError(f"the exported graph has no weight {min(missing)}, which it should have")
    return weights, model


def _without_weights(weights: set[str], model: ModelProto) -> bytes:
    """The model as bytes, with its weights left out."""
    for initializer in model.graph.initializer:
        if initializer.name in weights:
            initializer.ClearField("raw_data")
    return model.SerializeToString()
