"""Zenoh's trace becomes lines for an operator: refusals are warnings, connections are for debugging."""

from __future__ import annotations

import logging
import os

import pytest
from athrl_protocol.faults.zenoh_refusals import _read_trace

TRACE = (
    b"2026-01-01T00:00:00Z DEBUG acceptor ThreadId(02) zenoh_link_tls::unicast: Accepted TLS connection on "
    b"127.0.0.1:7447: 127.0.0.1:41000. Common Name: viewer.\n"
    b"2026-01-01T00:00:00Z  WARN acceptor ThreadId(02) zenoh_link_tls::unicast: peer sent no certificates. "
    b"Hint: too many open files?\n"
    b"a line of the program\n"
)


def test_connection_is_told_apart_from_a_refusal(caplog: pytest.LogCaptureFixture) -> None:
    reader, trace = os.pipe()
    passed_on, output = os.pipe()
    os.write(trace, TRACE)
    os.close(trace)
    with caplog.at_level(logging.DEBUG):
        _read_trace(reader, output)
    with os.fdopen(passed_on, "rb") as rest:
        assert rest.read() == b"a line of the program\n"
    told = [(record.levelname, record.name, record.getMessage()) for record in caplog.records]
    assert told == [
        (
            "DEBUG",
            "athrl_protocol.connections",
            "connected with the certificate 'viewer' from 127.0.0.1:41000",
        ),
        (
            "WARNING",
            "athrl_protocol.faults.zenoh_refusals",
            "a connection was refused: 'peer sent no certificates'",
        ),
    ]
