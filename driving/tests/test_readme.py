"""The examples of the package's page work as written."""

from __future__ import annotations

import re
from pathlib import Path

import onnx
import onnx.parser
import pytest
from athrl_driving.envs.settings import DEFAULTS
from athrl_driving.metrics import new_metrics, summary
from athrl_driving.reward import REWARD_TERMS
from athrl_spaces import WAYPOINT, LevelDescription, Limits, Observation, PolicyDescription, action_kind

PAGE = (Path(__file__).parents[1] / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
QUICK = [snippet for snippet in SNIPPETS if "stable_baselines3" not in snippet]
"""The other one takes long to train; test_stable_baselines.py does the same with fewer steps."""

GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,32,32,4] image, float[N,2] motion, float[N,2] plan_noise, float[N,2] forced_plan)
    => (float[N,2] plan)
{
    still = Sub (motion, motion)
    plan = Abs (still)
}
"""


def write_policy(path: Path) -> None:
    """Write a policy of one level that stands still."""
    limits = Limits()
    levels = (LevelDescription("plan", action_kind(WAYPOINT).describe(limits)),)
    description = PolicyDescription("test", WAYPOINT, limits, Observation(32), levels)
    model = onnx.parser.parse_model(GRAPH)
    onnx.helper.set_model_props(model, {"athrl": description.to_json()})
    path.write_bytes(model.SerializeToString())


def names_in_table(heading: str) -> list[str]:
    """Return the names in the first column of the table whose head is `heading`."""
    rows = PAGE.partition(f"| {heading} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


@pytest.mark.parametrize("snippet", QUICK, ids=range(len(QUICK)))
def test_snippet_runs(snippet: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_policy(tmp_path / "policy.onnx")
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "README.md", "exec"), {})


def test_snippets_are_found() -> None:
    assert len(QUICK) == len(SNIPPETS) - 1 == 7


def test_table_of_settings_is_whole_and_has_the_defaults() -> None:
    names = names_in_table("setting")
    assert sorted(names) == sorted(set(DEFAULTS) - {"observation", "action"})
    for row in re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", PAGE, re.MULTILINE):
        assert float(row[1]) == DEFAULTS[row[0]], row[0]


def test_table_of_reward_terms_is_whole() -> None:
    assert names_in_table('`info["reward_terms"]`') == list(REWARD_TERMS)


def test_table_of_metrics_is_whole() -> None:
    names = names_in_table('`info["metrics"]`')
    told = {f"comfort{name}" if name.startswith("_") else name for name in names}
    state = new_metrics(1)
    state.goal[:] = 1.0
    assert told == set(summary(state, 0, lasted=True))
