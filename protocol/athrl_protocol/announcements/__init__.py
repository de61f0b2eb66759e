"""What learner and evaluators announce: run file, policy, state and results; only the newest values."""

from athrl_protocol.announcements.evaluation import (
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
)
from athrl_protocol.announcements.policy import PolicyPublisher, PolicySubscriber, PolicyUpdate
from athrl_protocol.announcements.run_file_service import fetch_run_file, serve_run_file
from athrl_protocol.announcements.state import Phase, RunState, StatePublisher, StateSubscriber

__all__ = [
    "EvaluationPublisher",
    "EvaluationResult",
    "EvaluationSubscriber",
    "Phase",
    "PolicyPublisher",
    "PolicySubscriber",
    "PolicyUpdate",
    "RunState",
    "StatePublisher",
    "StateSubscriber",
    "fetch_run_file",
    "serve_run_file",
]
