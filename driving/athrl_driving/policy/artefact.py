"""Opens the file of a policy and checks that it is what its description says."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

# ONNX Runtime reads this when it is imported. Without it, it writes an id of the device into the user's home,
# and looks up its maker's host to report to it. A user who has set the variable has chosen.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

try:
    import onnxruntime
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "a policy runs with onnxruntime, which is not installed: pip install 'athrl-driving[policy]'",
        name=error.name,
    ) from None

from athrl_spaces import Continuous, InvalidDescription, LevelDescription, PolicyDescription
from athrl_spaces.policy import METADATA_KEY
from athrl_spaces.untrusted import one_line, parser_errors
from numpy.typing import NDArray

from athrl_driving.policy.graph import GraphCheck
from athrl_driving.policy.graph.onnx_model_pb2 import ValueInfo
from athrl_driving.policy.graph.values import FLOAT, UINT8, Value

_TYPES = {FLOAT: "tensor(float)", UINT8: "tensor(uint8)"}

_Expected = dict[str, tuple[int, tuple[int, ...]]]
"""Type of each input or output, and its shape without the batch dimension."""

_LONGEST_REASON = 200


class InvalidPolicy(ValueError):  # noqa: N818  (the name says what the file is)
    """A file or message is not a policy artefact that can be run; the text is one line for the user."""


class Artefact:
    """A policy that has been checked and opened.

    Attributes:
        description: what it sees and decides.
    """

    def __init__(self, artefact: bytes, threads: int) -> None:
        """Check an artefact's bytes, and open it to compute with so many threads; raises InvalidPolicy."""
        with parser_errors(InvalidPolicy, InvalidDescription):
            self._graph = GraphCheck(artefact)
            properties = self._graph.properties
            if METADATA_KEY not in properties:
                raise InvalidPolicy(
                    f"the ONNX file has no {METADATA_KEY!r} metadata, so it is not a policy of athrl"
                )
            self.description = PolicyDescription.from_json(properties[METADATA_KEY])
            self._inputs, self._outputs = _expected_tensors(self.description)
            _check_names("input", [each.name for each in self._graph.inputs], self._inputs)
            _check_names("output", self._graph.outputs, self._outputs)
            for declared in self._graph.inputs:
                _check_input(declared, *self._inputs[declared.name])
        self._batches: set[int] = set()
        self.check_batch(1)
        self._session = _open_session(artefact, threads)

    def check_batch(self, batch: int) -> None:
        """Raise InvalidPolicy if a decision for so many environments takes too much memory or time."""
        if batch in self._batches:
            return
        inputs = {name: Value((batch, *shape), dtype) for name, (dtype, shape) in self._inputs.items()}
        with parser_errors(InvalidPolicy):
            outputs = self._graph.sizes(inputs)
        for name, (dtype, shape) in self._outputs.items():
            value = outputs[name]
            if value.dtype != dtype or value.shape != (batch, *shape):
                raise InvalidPolicy(_wrong_tensor("output", name, value.dtype, value.shape, dtype, shape))
        self._batches.add(batch)

    def run(self, outputs: list[str], feed: Mapping[str, NDArray]) -> list[NDArray]:
        """Compute the outputs; raises InvalidPolicy if ONNX Runtime cannot."""
        with _runtime_errors("run"):
            results: list[NDArray] = self._session.run(outputs, dict(feed))
            return results


def takes_noise(level: LevelDescription) -> bool:
    """Whether the level has an input for noise, that is, a continuous action."""
    return any(isinstance(action, Continuous) for action in level.actions)


@contextmanager
def _runtime_errors(what: str) -> Iterator[None]:
    """Turn what ONNX Runtime raises into InvalidPolicy."""
    try:
        yield
    except Exception as error:  # its exceptions have no common base but Exception
        reason = one_line(str(error).split("\n")[0])[:_LONGEST_REASON]
        raise InvalidPolicy(f"ONNX Runtime cannot {what} it ({reason})") from None


def _open_session(artefact: bytes, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # a broken file is reported by the exception only
    with _runtime_errors("open"):
        return onnxruntime.InferenceSession(artefact, options, providers=["CPUExecutionProvider"])


def _expected_tensors(description: PolicyDescription) -> tuple[_Expected, _Expected]:
    """The exact inputs and outputs of a graph with this description."""
    seen = description.observation
    inputs: _Expected = {"image": (UINT8, seen.image_shape), "motion": (FLOAT, (seen.motion_size,))}
    outputs: _Expected = {}
    for level in description.levels:
        entries = (FLOAT, (level.action_size,))
        outputs[level.name] = inputs[f"forced_{level.name}"] = entries
        if takes_noise(level):
            inputs[f"{level.name}_noise"] = entries
        if level.state_size:
            state = (FLOAT, (level.state_size,))
            inputs[f"{level.name}_state"] = outputs[f"next_{level.name}_state"] = state
    return inputs, outputs


def _check_names(kind: str, found: list[str], expected: _Expected) -> None:
    if sorted(found) != sorted(expected):
        told = one_line(", ".join(sorted(found)))[:_LONGEST_REASON]
        raise InvalidPolicy(f"its {kind}s are {told}; they should be {', '.join(sorted(expected))}")


def _check_input(declared: ValueInfo, dtype: int, shape: tuple[int, ...]) -> None:
    """Compare an input with what it should be; a size without a number is that of the batch or unknown."""
    found = declared.type.tensor_type
    sizes = [each.dim_value for each in found.shape.dim]
    fits = len(sizes) == len(shape) + 1 and all(
        size in (0, wanted) for size, wanted in zip(sizes[1:], shape, strict=True)
    )
    if found.elem_type != dtype or not fits:
        raise InvalidPolicy(_wrong_tensor("input", declared.name, found.elem_type, sizes, dtype, shape))


def _wrong_tensor(
    kind: str, name: str, found: int, sizes: Sequence[int], dtype: int, shape: tuple[int, ...]
) -> str:
    return (
        f"its {kind} {name!r} is {_TYPES.get(found, f'of type {found}')} {list(sizes)[:20]}; it should be "
        f"{_TYPES[dtype]} [batch, {', '.join(str(size) for size in shape)}]"
    )
