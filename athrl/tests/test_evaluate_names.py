"""The command names drivers and case studies without importing the evaluator, which takes seconds."""

import athrl_evaluator

from athrl import evaluate


def test_command_names_what_the_evaluator_knows() -> None:
    assert set(evaluate.REFERENCE_DRIVERS) == set(athrl_evaluator.REFERENCE_DRIVERS)
    assert set(evaluate.CASE_STUDIES) == set(athrl_evaluator.CASE_STUDIES)
