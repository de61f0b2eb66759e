"""Settings in ATHRL_SET are the words of a command line, and errors name the variable."""

from __future__ import annotations

import pytest
from athrl.options import overrides
from athrl_protocol import RunFileError
from athrl_protocol.run_file import read_run_file


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("learner.batch=64  run.name=a", ["learner.batch=64", "run.name=a"]),
        ('environment.towns="a b/m.xodr" run.name=a', ['environment.towns="a b/m.xodr"', "run.name=a"]),
        ("environment.towns='a b.xodr'", ["environment.towns='a b.xodr'"]),
        ('environment.towns={"a b.xodr"=1,town03=2}', ['environment.towns={"a b.xodr"=1,town03=2}']),
        ("run.name=it's run.seed=3", ["run.name=it's", "run.seed=3"]),
        ("", []),
    ],
)
def test_a_value_in_quotes_may_have_spaces(
    given: str, wanted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATHRL_SET", given)
    assert overrides(["run.seed=7"]) == [*wanted, "run.seed=7"]


def test_path_with_a_space_is_one_town(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATHRL_SET", 'environment.towns="a b/m.xodr"')
    assert list(read_run_file(None, overrides(None)).environment.towns) == ["a b/m.xodr"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("environment.towns=a b/m.xodr", r"^ATHRL_SET b/m\.xodr: should look like .*; quotes hold a value"),
        ("learner.batch=0", "^ATHRL_SET learner.batch=0: should be"),
        ("learner.bach=64", "^ATHRL_SET learner.bach=64: .*did you mean learner.batch"),
    ],
)
def test_error_of_the_variable_names_it(given: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATHRL_SET", given)
    with pytest.raises(RunFileError, match=told):
        read_run_file(None, overrides(["environment.vehicles=3"]))
