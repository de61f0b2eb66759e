"""What an evaluator reports, and the scores of drivers."""

from __future__ import annotations

from athrl_protocol.monitoring.table.metric import Group, Metric

EVALUATOR = (
    Group(
        "evaluator",
        "athrl_evaluator_",
        (
            Metric("episodes", "episodes_total", "Episodes driven since the evaluator started."),
            Metric("policy_version", "policy_version", "Version of the policy that was scored last."),
            Metric(
                "environments_failed",
                "environments_failed_total",
                "Evaluations that an environment ended by raising or stalling; such a policy has no score.",
            ),
        ),
    ),
)
"""What an evaluator reports and shows at its endpoint; what it scored last is there as well, see `SCORES`."""

SCORES = (
    Group(
        "scores",
        "athrl_evaluation_",
        (
            Metric("episodes", "episodes", "How many episodes the scores are of."),
            Metric("return_mean", "return_mean", "Mean return of an episode."),
            Metric(
                "return_ci95",
                "return_ci95",
                "Half the 95 % interval of the mean return (Student's t).",
            ),
            Metric("speed_mps", "speed_metres_per_second", "Mean speed over all ticks, m/s."),
            Metric("distance_m", "distance_metres", "Metres of an episode."),
            Metric(
                "collision_rate",
                "collision_ratio",
                "Share of the episodes that ended by a collision.",
            ),
            Metric(
                "off_lane_rate",
                "off_lane_ratio",
                "Share that ended more than 2 m beside the route.",
            ),
            Metric(
                "full_episode_rate",
                "full_episode_ratio",
                "Share that lasted until the time limit or the end of the map.",
            ),
            Metric("success_rate", "success_ratio", "Mean of an episode's success, see below."),
            Metric(
                "success_seconds",
                "success_seconds",
                "Mean duration of the successful episodes, s; absent if there is none.",
            ),
            Metric("driving_score", "driving_score_ratio", "Mean of an episode's driving_score, 0 to 1."),
            Metric("comfort", "comfort_ratio", "Mean of an episode's comfort_all."),
            Metric(
                "time_to_collision_kept",
                "time_to_collision_kept_ratio",
                "Mean of the episodes' time_to_collision_kept.",
            ),
            Metric("red_lights", "red_lights", "Red lights run, an episode."),
        ),
    ),
)
"""Scores of a driver; both the learner's and the evaluator's endpoint show the newest of each."""
