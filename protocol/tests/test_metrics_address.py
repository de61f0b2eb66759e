"""Where a service answers Prometheus: on loopback unless another address is named."""

import pytest
from athrl_protocol.errors import ProtocolError, RunFileError
from athrl_protocol.monitoring.address import MetricsAddress, metrics_address
from athrl_protocol.run_file import read_run_file


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("9464", "127.0.0.1", 9464),
        ("10.0.0.7:1", "10.0.0.7", 1),
        ("node-7:65535", "node-7", 65_535),
        ("[::1]:9464", "::1", 9464),
        ("every-address:9464", "", 9464),
    ],
)
def test_port_alone_is_on_loopback_and_other_addresses_are_named(text: str, host: str, port: int) -> None:
    address = metrics_address(text)
    assert address == MetricsAddress(host, port)
    assert metrics_address(str(address)) == address


@pytest.mark.parametrize(
    "host", ["", "*", "0.0.0.0", "0", "00", "0x0", "[::]", "::", "[0:0:0:0:0:0:0:0]", "[::ffff:0.0.0.0]"]
)
def test_every_address_has_to_be_asked_for_by_that_name(host: str) -> None:
    with pytest.raises(
        ProtocolError, match=r"write every-address:9464 if that is meant, or 9464 for loopback"
    ):
        metrics_address(f"{host}:9464")


@pytest.mark.parametrize("text", ["", "abc", "0", "65536", "127.0.0.1:", "127.0.0.1:0", "1e3", "-1", "٩٤٦٤"])
def test_what_has_no_port_is_refused(text: str) -> None:
    with pytest.raises(
        ProtocolError, match=r"should be PORT \(on loopback\), HOST:PORT or every-address:PORT"
    ):
        metrics_address(text)


def test_run_file_holds_the_setting_to_the_same() -> None:
    assert read_run_file(None, ["metrics.listen=9464"]).metrics.listen == "9464"
    assert read_run_file(None).metrics.listen == ""
    with pytest.raises(RunFileError, match=r"--set metrics\.listen=0\.0\.0\.0:9464: .* every-address:9464"):
        read_run_file(None, ["metrics.listen=0.0.0.0:9464"])
