"""The check of an ONNX file: its parts, its operators, and the size of everything that it computes."""

from __future__ import annotations

from collections.abc import Mapping

from athrl_spaces.policy import LARGEST_ARTEFACT
from athrl_spaces.untrusted import one_line
from google.protobuf.message import DecodeError, Message
from google.protobuf.unknown_fields import UnknownFieldSet

from athrl_driving.policy.graph.onnx_model_pb2 import Graph, Model, ValueInfo
from athrl_driving.policy.graph.operators import MANY, OPERATORS
from athrl_driving.policy.graph.values import MOST_DIMENSIONS, NodeView, Value, constant

MOST_PARTS = 100_000
"""Nodes, their attributes, names of their inputs, constants, ...; the paper's planner has 2362."""
MOST_BYTES = 512 * 2**20
"""Of all values of one decision. The paper's planner has 0.4 MB for each environment."""
MOST_STEPS = 50_000_000_000
"""Multiplications and numbers read or written in one decision, which take some seconds on one core."""
OPSETS = range(13, 25)
"""Versions of ONNX's operators, whose rules are known here."""
ONNX_DOMAINS = ("", "ai.onnx")


class GraphCheck:
    """The structure of a policy; all methods raise ValueError, whose text follows "it is not a policy: ".

    A graph has no loops, and sizes follow from the size of the batch alone. So what a decision takes is known
    before the graph runs, and its sum is bounded.

    Attributes:
        properties: the metadata of the file.
    """

    def __init__(self, artefact: bytes) -> None:
        if len(artefact) > LARGEST_ARTEFACT:
            raise ValueError(f"it has {len(artefact):,} bytes; it should have at most {LARGEST_ARTEFACT:,}")
        try:
            model = Model.FromString(artefact)
        except DecodeError:
            raise ValueError("it is not an ONNX file") from None
        if not model.graph.node:
            raise ValueError("it is not an ONNX file, or an empty one")
        _refuse_unknown_parts(model)
        _check_operator_sets(model)
        self.properties = {each.key: each.value for each in model.metadata_props}
        self._constants = _constants(model.graph)
        # The nodes alone are kept: a message never frees a part of its memory.
        self._graph = Graph(node=model.graph.node, input=model.graph.input, output=model.graph.output)
        self._check_operators()

    @property
    def inputs(self) -> list[ValueInfo]:
        """The inputs as the file declares them."""
        return list(self._graph.input)

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return [output.name for output in self._graph.output]

    def sizes(self, inputs: Mapping[str, Value]) -> dict[str, Value]:
        """The values of the outputs for such inputs; raises ValueError if a decision would take too much."""
        values: dict[str, Value] = dict(self._constants)
        for name, value in inputs.items():
            _define(values, name, value)
        taken = steps = 0
        for node in self._graph.node:
            view = NodeView(node, [_defined(values, name) if name else None for name in node.input])
            outcome = OPERATORS[node.op_type].rule(view)
            if len(outcome.outputs) != len(node.output):
                raise view.error(f"has {len(node.output)} outputs; it should have {len(outcome.outputs)}")
            if any(len(value.shape) > MOST_DIMENSIONS for value in outcome.outputs):
                raise view.error(f"makes a value of more than {MOST_DIMENSIONS} sizes")
            written = outcome.scratch + sum(value.size for value in outcome.outputs)
            taken += 4 * outcome.scratch + sum(value.bytes for value in outcome.outputs)
            steps += outcome.products + written + sum(value.size for value in view.values if value)
            if taken > MOST_BYTES or steps > MOST_STEPS:
                raise ValueError(
                    f"a decision takes over {MOST_BYTES:,} bytes or {MOST_STEPS:,} steps, the last in its "
                    f"{node.op_type}"
                )
            for name, value in zip(node.output, outcome.outputs, strict=True):
                _define(values, name, value)
        return {name: _defined(values, name) for name in self.outputs}

    def _check_operators(self) -> None:
        for node in self._graph.node:
            operator = OPERATORS.get(node.op_type) if node.domain in ONNX_DOMAINS else None
            if operator is None:
                name = one_line(f"{node.domain}.{node.op_type}".strip("."))[:60]
                raise ValueError(f"it uses the operator {name}, which a policy may not use")
            needed = node.input if operator.most == MANY else node.input[: operator.required]
            fits = operator.required <= len(node.input) <= operator.most
            if not fits or not all(needed) or not all(node.output):
                raise ValueError(f"its {node.op_type} lacks an input or output, or has too many inputs")


def _constants(graph: Graph) -> dict[str, Value]:
    constants: dict[str, Value] = {}
    for tensor in graph.initializer:
        _define(constants, tensor.name, constant(tensor))
    return constants


def _define(values: dict[str, Value], name: str, value: Value) -> None:
    if name in values:
        raise ValueError(f"it computes {one_line(name)[:60]!r} twice")
    values[name] = value


def _defined(values: Mapping[str, Value], name: str) -> Value:
    if name not in values:
        raise ValueError(f"it uses {one_line(name)[:60]!r} before it is computed")
    return values[name]


def _check_operator_sets(model: Model) -> None:
    for each in model.opset_import:
        if each.domain in ONNX_DOMAINS and each.version not in OPSETS:
            known = f"{OPSETS.start} to {OPSETS.stop - 1}"
            raise ValueError(f"it has version {each.version} of ONNX's operators; it should be {known}")


def _refuse_unknown_parts(model: Model) -> None:
    """Refuse what the schema of policies does not have, such as functions, and very many parts."""
    count, waiting = 0, [model]
    while waiting:
        message: Message = waiting.pop()
        unknown = UnknownFieldSet(message)
        if len(unknown):
            kind, number = message.DESCRIPTOR.name, unknown[0].field_number
            raise ValueError(f"its {kind} has the field {number} of ONNX, which a policy may not have")
        for field, value in message.ListFields():
            parts = value if field.is_repeated else [value]
            if field.message_type is None and field.type != field.TYPE_STRING:
                continue
            count += len(parts)
            if count > MOST_PARTS:
                raise ValueError(f"it has more than {MOST_PARTS:,} parts")
            if field.message_type is not None:
                waiting.extend(parts)
