"""Run a policy artefact with ONNX Runtime over a batch of environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

try:
    import onnxruntime
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "a policy runs with onnxruntime, which is not installed: pip install 'athrl-driving[policy]'",
        name=error.name,
    ) from None

from athrl_driving.policy.metadata import InvalidPolicy, LevelMetadata, PolicyMetadata, parse_metadata

METADATA_KEY = "athrl"
LARGEST_ARTEFACT = 1 << 30  # bytes; beyond this a file is surely not a policy

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class PolicyStep:
    """What a policy decided, per level: actions float32 [batch, n] in physical units, and the next states."""

    actions: dict[str, np.ndarray]
    states: dict[str, np.ndarray]  # float32 [batch, state]


class OnnxPolicy:
    """A policy artefact, ready to drive; recurrent states are the caller's, so policies can be switched."""

    def __init__(self, artefact: bytes, threads: int = 1) -> None:
        """Take the artefact's bytes; raises InvalidPolicy if they are not a policy."""
        self._session = _open_session(artefact, threads)
        properties = self._session.get_modelmeta().custom_metadata_map
        if METADATA_KEY not in properties:
            raise InvalidPolicy(
                f"the ONNX file has no {METADATA_KEY!r} metadata, so it is not a policy of athrl"
            )
        self.metadata: PolicyMetadata = parse_metadata(properties[METADATA_KEY])
        _check_graph(self._session, self.metadata)
        self._outputs = [level.name for level in self.metadata.levels]
        self._outputs += [f"next_{level.name}_state" for level in self.metadata.levels]

    @classmethod
    def load(cls, path: Path | str, threads: int = 1) -> OnnxPolicy:
        """Read a policy file; raises InvalidPolicy, naming the file."""
        try:
            path = Path(path)
            if path.stat().st_size > LARGEST_ARTEFACT:
                raise InvalidPolicy("it is larger than 1 GiB")
            return cls(path.read_bytes(), threads)
        except OSError as error:
            raise InvalidPolicy(f"cannot read the policy {path}: {error.strerror}") from None
        except InvalidPolicy as error:
            raise InvalidPolicy(f"{path} is not a policy: {error}") from None

    def initial_states(self, batch: int) -> dict[str, np.ndarray]:
        """The recurrent states at an episode's start: float32 zeros [batch, state] for each level."""
        return {level.name: np.zeros((batch, level.state_size), np.float32) for level in self.metadata.levels}

    def step(
        self,
        images: np.ndarray,
        motion: np.ndarray,
        states: Arrays,
        noise: Arrays | None = None,
        forced: Arrays | None = None,
    ) -> PolicyStep:
        """Decide for a batch.

        `images` uint8 [batch, height, width, channels], `motion` float32 [batch, m]; of each level `states`
        float32 [batch, state], `noise` float32 [batch, n] in physical units (missing: none) and `forced`
        float32 [batch, n] (NaN or missing: free). A level sees the actions of the levels above it with their
        noise. The returned actions lie within their ranges; raises InvalidPolicy if they are not finite.
        """
        feed = self._feed(images, motion, states, noise or {}, forced or {})
        values = self._session.run(self._outputs, feed)
        if not all(np.isfinite(value).all() for value in values):
            raise InvalidPolicy("the policy returned values that are not finite; its training has diverged")
        count = len(self.metadata.levels)
        names = self._outputs[:count]
        actions = dict(zip(names, values[:count], strict=True))
        last = self.metadata.acting_level
        actions[last.name] = _explore(last, actions[last.name], noise or {}, forced or {})
        return PolicyStep(actions=actions, states=dict(zip(names, values[count:], strict=True)))

    def _feed(
        self, images: np.ndarray, motion: np.ndarray, states: Arrays, noise: Arrays, forced: Arrays
    ) -> dict[str, np.ndarray]:
        batch = len(images)
        feed = {"image": images, "motion": motion}
        for level in self.metadata.levels:
            feed[f"{level.name}_state"] = states[level.name]
        for level in self.metadata.levels[:-1]:
            shape = (batch, level.action_size)
            quiet, free = np.zeros(shape, np.float32), np.full(shape, np.nan, np.float32)
            feed[f"{level.name}_noise"] = noise.get(level.name, quiet)
            feed[f"forced_{level.name}"] = forced.get(level.name, free)
        return feed


def _explore(level: LevelMetadata, actions: np.ndarray, noise: Arrays, forced: Arrays) -> np.ndarray:
    """The acting level's actions with its noise; nothing in the graph needs it, so it is added outside."""
    if level.name in noise:
        actions = actions + noise[level.name]
    if level.name in forced:
        actions = np.where(np.isnan(forced[level.name]), actions, forced[level.name])
    return np.clip(actions, level.low, level.high).astype(np.float32)


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


def _check_graph(session: onnxruntime.InferenceSession, metadata: PolicyMetadata) -> None:
    """The graph must have just the inputs and outputs that the metadata speaks of."""
    inputs: dict[str, tuple[str, tuple[int, ...]]] = {
        "image": ("tensor(uint8)", metadata.image_shape),
        "motion": ("tensor(float)", (len(metadata.motion),)),
    }
    outputs: dict[str, tuple[str, tuple[int, ...]]] = {}
    for level in metadata.levels:
        inputs[f"{level.name}_state"] = ("tensor(float)", (level.state_size,))
        outputs[level.name] = ("tensor(float)", (level.action_size,))
        outputs[f"next_{level.name}_state"] = ("tensor(float)", (level.state_size,))
    for level in metadata.levels[:-1]:
        inputs[f"{level.name}_noise"] = ("tensor(float)", (level.action_size,))
        inputs[f"forced_{level.name}"] = ("tensor(float)", (level.action_size,))
    _check_tensors("input", session.get_inputs(), inputs)
    _check_tensors("output", session.get_outputs(), outputs)


def _check_tensors(
    kind: str, tensors: list[onnxruntime.NodeArg], expected: dict[str, tuple[str, tuple[int, ...]]]
) -> None:
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
