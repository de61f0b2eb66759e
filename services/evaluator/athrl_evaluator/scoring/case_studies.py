"""The paper's case studies by short names, for evaluations."""

from __future__ import annotations

from typing import Any

from athrl_driving.scenarios import SCENARIOS
from athrl_spaces import CASE_STUDIES


def case_study_settings(case_study: str) -> dict[str, Any]:
    """What a case study fixes of an environment's settings: town, start, destination, traffic, time."""
    return dict(SCENARIOS[CASE_STUDIES[case_study]])
