"""The file of a policy: opened, and checked to be what its description says."""

from __future__ import annotations

try:
    import onnxruntime
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "a policy runs with onnxruntime, which is not installed: pip install 'athrl-driving[policy]'",
        name=error.name,
    ) from None

from athrl_spaces import Continuous, InvalidDescription, LevelDescription, PolicyDescription

METADATA_KEY = "athrl"

_FLOATS, _BYTES = "tensor(float)", "tensor(uint8)"

_Expected = dict[str, tuple[str, tuple[int, ...]]]
"""Type and shape without the batch of each input or output."""


class InvalidPolicy(ValueError):  # noqa: N818  (the name says what the file is)
    """A file or message is not a policy artefact that can be run; the text is one line for the user."""


def open_artefact(artefact: bytes, threads: int) -> tuple[onnxruntime.InferenceSession, PolicyDescription]:
    """Open an artefact that computes with so many threads; raises InvalidPolicy if it is none."""
    session = _open_session(artefact, threads)
    properties = session.get_modelmeta().custom_metadata_map
    if METADATA_KEY not in properties:
        raise InvalidPolicy(f"the ONNX file has no {METADATA_KEY!r} metadata, so it is not a policy of athrl")
    try:
        description = PolicyDescription.from_json(properties[METADATA_KEY])
    except InvalidDescription as error:
        raise InvalidPolicy(str(error)) from None
    inputs, outputs = _expected_tensors(description)
    _check_tensors("input", session.get_inputs(), inputs)
    _check_tensors("output", session.get_outputs(), outputs)
    return session, description


def takes_noise(level: LevelDescription) -> bool:
    """Whether the level has an input for noise: it decides a number, not choices alone."""
    return any(isinstance(action, Continuous) for action in level.actions)


def _open_session(artefact: bytes, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # a broken file is told by the exception, once
    try:
        return onnxruntime.InferenceSession(artefact, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's exceptions have no common base but Exception
        reason = str(error).split("\n")[0][:200]
        raise InvalidPolicy(f"ONNX Runtime cannot open it ({reason})") from None


def _expected_tensors(description: PolicyDescription) -> tuple[_Expected, _Expected]:
    """The inputs and outputs that a graph of this description has, and no others."""
    seen = description.observation
    inputs: _Expected = {"image": (_BYTES, seen.image_shape), "motion": (_FLOATS, (seen.motion_size,))}
    outputs: _Expected = {}
    for level in description.levels:
        entries = (_FLOATS, (level.action_size,))
        outputs[level.name] = inputs[f"forced_{level.name}"] = entries
        if takes_noise(level):
            inputs[f"{level.name}_noise"] = entries
        if level.state_size:
            state = (_FLOATS, (level.state_size,))
            inputs[f"{level.name}_state"] = outputs[f"next_{level.name}_state"] = state
    return inputs, outputs


def _check_tensors(kind: str, tensors: list[onnxruntime.NodeArg], expected: _Expected) -> None:
    found = {tensor.name: tensor for tensor in tensors}
    if set(found) != set(expected):
        raise InvalidPolicy(
            f"its {kind}s are {', '.join(sorted(found))}; they should be {', '.join(sorted(expected))}"
        )
    for name, (dtype, shape) in expected.items():
        tensor = found[name]
        sizes = tuple(tensor.shape[1:])
        unknown = [not isinstance(size, int) for size in sizes]
        fits = len(sizes) == len(shape) and all(
            skip or size == wanted for skip, size, wanted in zip(unknown, sizes, shape, strict=True)
        )
        if tensor.type != dtype or not fits:
            raise InvalidPolicy(
                f"its {kind} {name!r} is {tensor.type} {list(tensor.shape)}; it should be {dtype} [batch, "
                f"{', '.join(str(size) for size in shape)}]"
            )
