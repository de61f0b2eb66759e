"""The run file that lies in the checkout is the documented default."""

from pathlib import Path

from athrl_protocol.run_file import RunFile, default_toml, read_run_file

FILE = Path(__file__).parents[1] / "town03.toml"


def test_run_file_in_the_checkout_is_the_default() -> None:
    assert FILE.read_text() == default_toml(), "write it anew: athrl run-file > town03.toml"
    assert read_run_file(FILE) == RunFile()
