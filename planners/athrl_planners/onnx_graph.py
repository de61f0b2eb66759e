"""A small ONNX graph builder that knows the torch layers our networks are made of.

The graph is written once; each weight is an initializer with the name of its torch parameter, so that later
weights can be put in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

OPSET = 17  # the first with LayerNormalization
IR_VERSION = 8


class OnnxGraph:
    """Nodes, inputs, outputs and weights under construction. Methods take and return value names."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []
        self._initializers: dict[str, onnx.TensorProto] = {}
        self.weights: list[str] = []  # names of the initializers that are torch parameters

    def input(self, name: str, dtype: int, shape: Sequence[int]) -> str:
        """An input of [batch, *shape]."""
        self._inputs.append(helper.make_tensor_value_info(name, dtype, ["batch", *shape]))
        return name

    def output(self, name: str, value: str, shape: Sequence[int]) -> None:
        """Make float32 [batch, *shape] `value` an output called `name`."""
        self._nodes.append(helper.make_node("Identity", [value], [name]))
        self._outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape]))

    def constant(self, value: np.ndarray) -> str:
        """A value that publications never change."""
        name = f"constant_{len(self._initializers)}"
        self._initializers[name] = numpy_helper.from_array(value, name)
        return name

    def weight(self, name: str, value: Tensor) -> str:
        """A torch parameter; `name` is its name in the state dict."""
        self._initializers[name] = numpy_helper.from_array(value.detach().cpu().numpy(), name)
        self.weights.append(name)
        return name

    def node(self, operator: str, *inputs: str, outputs: int = 1, **attributes: Any) -> list[str]:
        """Any ONNX operator; returns the names of its outputs."""
        names = [f"{operator}_{len(self._nodes)}_{number}" for number in range(outputs)]
        self._nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names

    def call(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """An ONNX operator with one output."""
        return self.node(operator, *inputs, **attributes)[0]

    def layer(self, module: nn.Module, name: str, value: str) -> str:
        """A torch layer applied to `value`; `name` is the layer's name in the state dict."""
        match module:
            case nn.Sequential():
                for child_name, child in module.named_children():
                    value = self.layer(child, f"{name}.{child_name}", value)
                return value
            case nn.Linear():
                weights = (
                    self.weight(f"{name}.weight", module.weight),
                    self.weight(f"{name}.bias", module.bias),
                )
                return self.call("Gemm", value, *weights, transB=1)
            case nn.LayerNorm():
                weights = (
                    self.weight(f"{name}.weight", module.weight),
                    self.weight(f"{name}.bias", module.bias),
                )
                return self.call("LayerNormalization", value, *weights, axis=-1, epsilon=module.eps)
            case nn.Conv2d():
                assert module.bias is not None
                weights = (
                    self.weight(f"{name}.weight", module.weight),
                    self.weight(f"{name}.bias", module.bias),
                )
                padding = [int(size) for size in module.padding]
                return self.call("Conv", value, *weights, strides=list(module.stride), pads=padding + padding)
            case nn.ReLU():
                return self.call("Relu", value)
            case nn.Flatten():
                return self.call("Flatten", value, axis=1)
        raise TypeError(f"{name} is a {type(module).__name__}, which the export does not know")

    def lstm_step(self, lstm: nn.LSTM, name: str, value: str, output: str, cell: str) -> tuple[str, str]:
        """One step of a one-layer LSTM: the next output and cell, [batch, units] each."""
        gates = []
        for part, source in (("ih", value), ("hh", output)):
            weight, bias = (f"{kind}_{part}_l0" for kind in ("weight", "bias"))
            names = [self.weight(f"{name}.{key}", getattr(lstm, key)) for key in (weight, bias)]
            gates.append(self.call("Gemm", source, *names, transB=1))
        split = self.constant(np.full(4, lstm.hidden_size, np.int64))
        parts = self.node("Split", self.call("Add", *gates), split, outputs=4, axis=1)
        enter, forget, leave = (self.call("Sigmoid", parts[number]) for number in (0, 1, 3))
        fresh = self.call("Mul", enter, self.call("Tanh", parts[2]))
        cell = self.call("Add", self.call("Mul", forget, cell), fresh)
        return self.call("Mul", leave, self.call("Tanh", cell)), cell

    def model(self, metadata: dict[str, str]) -> onnx.ModelProto:
        """The finished model, checked."""
        graph = helper.make_graph(
            self._nodes, "policy", self._inputs, self._outputs, list(self._initializers.values())
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="athrl"
        )
        model.ir_version = IR_VERSION
        helper.set_model_props(model, metadata)
        onnx.checker.check_model(model, full_check=True)
        return model
