"""The schema: committed code is current, and programs of different schemas refuse each other."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from athrl_protocol import SCHEMA_HASH, SCHEMA_VERSION, InvalidMessage
from athrl_protocol.announcements import evaluation, policy, state
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import decode_message, encode_message

PROTOCOL = Path(__file__).parents[1]


def test_committed_code_is_what_the_schema_generates(tmp_path: Path) -> None:
    specification = importlib.util.spec_from_file_location("generate", PROTOCOL / "generate.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    module.generate(tmp_path)
    committed = Path(athrl_pb2.__file__).parent
    for name in ("athrl_pb2.py", "athrl_pb2.pyi"):
        assert (committed / name).read_text() == (tmp_path / name).read_text(), "run protocol/generate.py"


def test_every_message_carries_version_and_hash() -> None:
    message = athrl_pb2.Metrics.FromString(encode_message(athrl_pb2.Metrics(role="actor")))
    assert (message.schema_version, message.schema_hash) == (SCHEMA_VERSION, SCHEMA_HASH)


def test_every_message_that_travels_alone_begins_with_version_and_hash() -> None:
    parts = {"Level", "Point", "Vehicle"}
    for name, descriptor in athrl_pb2.DESCRIPTOR.message_types_by_name.items():
        if name not in parts:
            numbers = [(field.number, field.name) for field in descriptor.fields[:2]]
            assert numbers == [(1, "schema_version"), (2, "schema_hash")], name


@pytest.mark.parametrize("change", [{"schema_version": 99}, {"schema_hash": 1}])
def test_message_of_another_schema_is_refused_by_name(change: dict[str, int]) -> None:
    message = athrl_pb2.Metrics.FromString(encode_message(athrl_pb2.Metrics(role="actor")))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(InvalidMessage, match=r"Metrics: schema .* this program has schema") as caught:
        decode_message(athrl_pb2.Metrics, message.SerializeToString())
    assert caught.value.reason == "schema"


def _policy(**counts: int) -> bytes:
    return encode_message(athrl_pb2.Policy(sha256=hashlib.sha256(b"").digest(), **counts))


def _state(**counts: int) -> bytes:
    return encode_message(athrl_pb2.RunState(phase=athrl_pb2.RunState.TRAINING, **counts))


def _evaluation(**counts: int) -> bytes:
    return encode_message(athrl_pb2.Evaluation(driver="policy", town="town03", **counts))


@pytest.mark.parametrize(
    ("encode", "decode", "count"),
    [
        (_policy, policy._decode, "version"),
        (_policy, policy._decode, "environment_steps"),
        (_state, state._decode, "environment_steps"),
        (_state, state._decode, "policy_version"),
        (_evaluation, evaluation._decode, "policy_version"),
        (_evaluation, evaluation._decode, "environment_steps"),
    ],
)
def test_count_that_a_signed_integer_cannot_hold_is_refused_by_name(
    encode: Callable[..., bytes], decode: Callable[[bytes], Any], count: str
) -> None:
    assert getattr(decode(encode(**{count: 2**63 - 1})), count) == 2**63 - 1
    with pytest.raises(InvalidMessage, match=rf"{count} is 9223372036854775808, should be at most 2\^63 - 1"):
        decode(encode(**{count: 2**63}))
