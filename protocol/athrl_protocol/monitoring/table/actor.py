"""What an actor reports; the learner's endpoint shows it."""

from __future__ import annotations

from athrl_protocol.monitoring.table.metric import Group, Metric

ACTOR = (
    Group(
        "actor driving",
        "athrl_actor_",
        (
            Metric("decisions", "decisions_total", "Decisions since the actor started."),
            Metric(
                "decisions_per_second",
                "decisions_per_second",
                "Decisions per second in the last minute.",
            ),
            Metric("episodes", "episodes_total", "Episodes that ended."),
            Metric(
                "return_mean",
                "return_mean",
                "Mean return of the last 20 episodes, with exploration.",
            ),
            Metric(
                "collision_rate",
                "collision_ratio",
                "Share of the last 20 episodes that ended by a collision, with exploration.",
            ),
            Metric("return_mean/TOWN", "town_return_mean", "The mean return in each of several towns."),
            Metric(
                "collision_rate/TOWN",
                "town_collision_ratio",
                "The share of collisions in each of several towns.",
            ),
            Metric("speed", "speed_metres_per_second", "Mean speed since the last report."),
            Metric("policy_version", "policy_version", "Version of the policy that decides."),
            Metric(
                "policy_lag_versions",
                "policy_lag_versions",
                "Versions that the newest known policy is ahead of the one that decides.",
            ),
            Metric(
                "policy_lag_seconds",
                "policy_lag_seconds",
                "For how long the actor has known of a newer policy.",
            ),
            Metric(
                "policy_delivery_seconds",
                "policy_delivery_seconds",
                "From the publication of the policy that decides to its first use.",
            ),
            Metric(
                "environments_failed",
                "environments_failed_total",
                "Steps and resets of environments that raised.",
            ),
            Metric(
                "environments_stalled",
                "environments_stalled_total",
                "Steps and resets that did not return within actor.stall_seconds.",
            ),
            Metric(
                "chunks_dropped",
                "chunks_dropped_total",
                "Open chunks that were lost with environments that failed; they were never produced.",
            ),
        ),
    ),
    Group(
        "actor chunks",
        "athrl_actor_",
        (
            Metric("chunks_produced", "chunks_produced_total", "Chunks made."),
            Metric(
                "chunks_acknowledged",
                "chunks_acknowledged_total",
                "Chunks stored by the learner.",
            ),
            Metric("chunks_waiting", "chunks_waiting", "Chunks held that are not acknowledged yet."),
            Metric(
                "chunks_resent",
                "chunks_resent_total",
                "Chunks sent once more after silence or behind a gap, each time.",
            ),
            Metric(
                "chunks_turned_away",
                "chunks_turned_away_total",
                "Chunks sent once more because the learner had no use for them yet: how it slows actors.",
            ),
            Metric("chunks_given_up", "chunks_given_up_total", "Chunks given up."),
            Metric(
                "chunks_given_up/REASON",
                "chunks_given_up_by_reason_total",
                "Chunks given up, by reason: invalid, finished, closed, bound.",
            ),
        ),
    ),
)
"""What an actor reports; the learner's endpoint shows it."""

REPORTING = Metric("", "reporting", "Actors that reported in the last ten seconds.")
