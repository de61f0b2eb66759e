"""The endpoint answers Prometheus, and no client of it disturbs the service or other clients for long."""

import http.client
import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from athrl_protocol.errors import AddressInUse, ProtocolError
from athrl_protocol.monitoring import endpoint as module
from athrl_protocol.monitoring.address import MetricsAddress, metrics_address
from athrl_protocol.monitoring.endpoint import MetricsEndpoint, serve_metrics
from athrl_protocol.monitoring.figures import ServiceFigures
from athrl_protocol.monitoring.table import LEARNER
from prometheus_client.openmetrics import parser as open_metrics
from prometheus_client.parser import text_string_to_metric_families

PATIENCE = 30.0
OPEN_METRICS = "application/openmetrics-text; version=1.0.0,text/plain;version=0.0.4;q=0.5"


@pytest.fixture
def figures() -> ServiceFigures:
    figures = ServiceFigures(LEARNER, {"run": "town03"})
    figures.show({"updates": 5.0, "policy_lag/rig-1": 3.0})
    return figures


@pytest.fixture
def endpoint(port: int, figures: ServiceFigures) -> Iterator[MetricsEndpoint]:
    with MetricsEndpoint(metrics_address(str(port)), [figures]) as endpoint:
        yield endpoint


def get(port: int, path: str = "/metrics", method: str = "GET", **headers: str) -> tuple[int, str, str]:
    """Status, content type and text of the answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.getheader("Content-Type", ""), answer.read().decode()
    finally:
        connection.close()


@pytest.mark.usefixtures("endpoint")
def test_both_formats_of_prometheus_are_answered_with_help_and_type(port: int) -> None:
    status, kind, text = get(port)
    assert status == 200
    assert kind.startswith("text/plain; version=0.0.4")
    plain = {family.name: family for family in text_string_to_metric_families(text)}
    assert plain["athrl_learner_updates"].documentation == "Updates of the planner in the run."
    assert plain["athrl_learner_updates"].type == "counter"
    assert plain["athrl_learner_updates"].samples[0].value == 5
    assert "process_resident_memory_bytes" in plain

    _, kind, text = get(port, Accept=OPEN_METRICS)
    assert kind.startswith("application/openmetrics-text; version=1.0.0")
    assert {family.name for family in open_metrics.text_string_to_metric_families(text)} == set(plain)


@pytest.mark.usefixtures("endpoint")
def test_new_values_are_shown(port: int, figures: ServiceFigures, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FRESH_SECONDS", 0.0)
    figures.show({"updates": 6.0})
    assert 'athrl_learner_updates_total{run="town03"} 6.0' in get(port)[2]


@pytest.mark.usefixtures("endpoint")
def test_nothing_but_metrics_is_there_to_read(port: int) -> None:
    assert get(port, "/")[0] == 404
    assert get(port, "/metrics/../../etc/passwd")[0] == 404
    assert get(port, method="POST")[0] == 501
    assert get(port, method="DELETE")[0] == 501
    assert get(port, "/metrics?name[]=x")[0] == 200


@pytest.mark.usefixtures("endpoint")
def test_slow_clients_are_left_and_others_are_answered(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REQUEST_SECONDS", 0.5)
    began = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(3 * module.THREADS)]
    for each in idle:
        each.sendall(b"GET /metrics HTTP/1.0\r\nX: ")  # and never the rest
    assert get(port)[0] == 200
    assert threading.active_count() <= began
    for each in idle:
        each.close()


@pytest.mark.usefixtures("endpoint")
def test_client_that_drips_has_one_deadline_for_its_whole_request(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REQUEST_SECONDS", 0.5)
    with socket.create_connection(("127.0.0.1", port)) as dripping:
        dripping.settimeout(0.1)
        deadline = time.monotonic() + PATIENCE
        while not _is_closed(dripping):
            assert time.monotonic() < deadline, "it is still heard"


def _is_closed(connection: socket.socket) -> bool:
    """Send one more byte; whether the other side has left."""
    try:
        connection.sendall(b"x")
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except OSError:
        return True


@pytest.mark.usefixtures("endpoint")
@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET /metrics HTTP/1.0\r\n" + b"X: y\r\n" * 100_000,
        b"GET /" + b"a" * 1_000_000,
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\x00" * 200 + b"\r\n\r\n",
        b"\r\n\r\n",
        b"GET /metrics HTTP/9.9\r\n\r\n",
        b"GET /metrics HTTP/1.0\r\nAccept: application/openmetrics-text; version=x\r\n y\r\n\r\n",
        b"\xff\xfe /metrics\n\n",
    ],
    ids=["headers", "path", "tls", "empty", "version", "accept", "bytes"],
)
def test_whatever_a_client_sends_the_next_one_is_answered(port: int, request_bytes: bytes, caplog) -> None:
    for _ in range(module.THREADS + 1):
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.settimeout(PATIENCE)
            try:
                client.sendall(request_bytes)
                while client.recv(65_536):
                    pass
            except ConnectionError:
                pass  # it was cut off in the middle of what it sent
    assert get(port)[0] == 200
    assert not caplog.records


@pytest.mark.usefixtures("endpoint")
def test_client_that_reads_nothing_is_left(
    port: int, figures: ServiceFigures, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REQUEST_SECONDS", 0.5)
    monkeypatch.setattr(module, "FRESH_SECONDS", 0.0)
    monkeypatch.setattr(module._Texts, "of", lambda self, accepted: ("text/plain", b"x" * 50_000_000))
    deaf = [socket.create_connection(("127.0.0.1", port)) for _ in range(2 * module.THREADS)]
    for each in deaf:
        each.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
    assert get(port, "/")[0] == 404
    for each in deaf:
        each.close()


@pytest.mark.usefixtures("endpoint")
def test_many_requests_cost_few_texts(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FRESH_SECONDS", 3600.0)
    collected = []
    original = ServiceFigures.collect
    monkeypatch.setattr(ServiceFigures, "collect", lambda self: collected.append(1) or original(self))
    for version in range(20):
        assert get(port, Accept=f"application/openmetrics-text; version=1.0.{version}")[0] == 200
        assert get(port, Accept=f"text/plain; version=1.0.{version}")[0] == 200
    assert len(collected) <= 2


def test_port_in_use_is_refused_in_one_line(port: int, endpoint: MetricsEndpoint) -> None:
    with pytest.raises(AddressInUse, match=rf"cannot serve metrics at 127\.0\.0\.1:{port}: another process"):
        MetricsEndpoint(metrics_address(str(port)), [])


def test_address_of_another_machine_is_refused_in_one_line(port: int) -> None:
    for host in ("192.0.2.1", "no-such-host.invalid"):
        with pytest.raises(ProtocolError, match=rf"cannot serve metrics at {host}:{port}: [a-z ]+$"):
            MetricsEndpoint(MetricsAddress(host, port), [])


@pytest.mark.parametrize("host", ["a\x00b", "\xe9" * 80], ids=["NUL", "too long once encoded"])
def test_what_can_be_no_hosts_name_is_refused_in_one_line(host: str, port: int) -> None:
    with pytest.raises(ProtocolError, match=r"cannot serve metrics at '.*': that is no host's name$"):
        MetricsEndpoint(MetricsAddress(host, port), [])


def test_every_address_is_reached_by_each_one(port: int) -> None:
    with MetricsEndpoint(metrics_address(f"every-address:{port}"), []):
        assert get(port)[0] == 200


def test_closed_endpoint_gives_up_its_port_and_threads(
    port: int, eventually: Callable[[Callable[[], bool]], None]
) -> None:
    before = threading.active_count()
    for _ in range(3):
        with serve_metrics(str(port)):
            assert get(port)[0] == 200
    eventually(lambda: threading.active_count() <= before)


def test_without_an_address_nothing_listens() -> None:
    before = threading.active_count()
    with serve_metrics(""):
        assert threading.active_count() == before
