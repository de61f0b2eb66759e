"""Versions never repeat, and noise falls as the run file says."""

import pytest
from athrl_learner.publication import annealed_noise, recorded_version


@pytest.mark.parametrize(("steps", "scale"), [(0, 1.0), (50, 0.75), (100, 0.5), (120, 0.5)])
def test_noise_falls_linearly_to_its_final_scale(steps, scale):
    assert annealed_noise(steps, target=100, final_scale=0.5) == pytest.approx(scale)


@pytest.mark.parametrize(
    ("content", "version"),
    [('{"version": 12}', 12), ("{}", -1), ("[]", -1), ("", -1), ('{"version": "x"}', -1), (None, -1)],
)
def test_the_newest_version_is_known_from_the_folder(tmp_path, content, version):
    if content is not None:
        (tmp_path / "latest.json").write_text(content)
    assert recorded_version(tmp_path / "latest.json") == version
