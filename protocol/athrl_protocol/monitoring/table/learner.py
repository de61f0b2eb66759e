"""What the learner reports, and shows at its endpoint."""

from __future__ import annotations

from athrl_protocol.monitoring.table.metric import Group, Metric

LEARNER = (
    Group(
        "learner progress",
        "athrl_learner_",
        (
            Metric("environment_steps", "environment_steps_total", "Decisions accepted in the run."),
            Metric(
                "environment_steps_per_second",
                "environment_steps_per_second",
                "Decisions accepted per second in the last minute.",
            ),
            Metric(
                "environment_steps_target",
                "environment_steps_target",
                "Decisions after which the run ends.",
            ),
            Metric("updates", "updates_total", "Updates of the planner in the run."),
            Metric("updates_per_second", "updates_per_second", "Updates per second in the last minute."),
            Metric("update_seconds", "update_seconds", "Seconds spent in updates since the last report."),
            Metric(
                "trained_per_second",
                "trained_per_second",
                "Decisions trained per second of updates, each as often as it was drawn, without padding.",
            ),
            Metric("policy_version", "policy_version", "Version of the newest policy."),
            Metric("noise_scale", "noise_scale_ratio", "Factor on exploration noise."),
            Metric("actors", "actors", "Actors that are present."),
            Metric(
                "actors_left",
                "actors_left_total",
                "Actors that left before the end of the run and were not back within 5 s, since this "
                "learner started.",
            ),
            Metric(
                "rivals/answerers",
                "rival_answerers_total",
                "Keys that only the learner should answer and another process did, each once while it "
                "stayed.",
            ),
            Metric(
                "rivals/values",
                "rival_values_total",
                "Values that another process published under the learner's keys.",
            ),
        ),
    ),
    Group(
        "learner replay",
        "athrl_learner_",
        (
            Metric("replay_transitions", "replay_transitions", "Transitions in the replay."),
            Metric("replay_fill", "replay_fill_ratio", "Share of the replay's places that are taken."),
            Metric(
                "samples_per_insert",
                "samples_per_insert",
                "How often a transition was drawn, on average, since the warm-up.",
            ),
            Metric(
                "waiting/learner",
                "waiting_for_data_ratio",
                "Share of the time between two reports that the learner waited for data.",
            ),
            Metric(
                "waiting/actors",
                "keeping_actors_waiting_ratio",
                "Share of the time between two reports that actors waited for the learner.",
            ),
            Metric("waiting/disk", "waiting_for_disk", "1 while intake is paused because the disk is full."),
        ),
    ),
    Group(
        "learner policy lag",
        "athrl_learner_",
        (
            Metric(
                "policy_lag",
                "policy_lag_versions",
                "Versions by which an actor's last chunk was behind when it arrived, the worst actor's.",
            ),
            Metric(
                "policy_lag/ACTOR",
                "actor_policy_lag_versions",
                "Versions by which this actor's last chunk was behind when it arrived.",
            ),
            Metric(
                "policy_lag_seconds",
                "policy_lag_seconds",
                "Seconds for which there had been a newer policy than that of a chunk, the worst actor's.",
            ),
            Metric(
                "policy_lag_seconds/ACTOR",
                "actor_policy_lag_seconds",
                "Seconds for which there had been a newer policy than that of this actor's last chunk.",
            ),
            Metric(
                "transitions/ACTOR",
                "actor_transitions_total",
                "Transitions accepted from this actor since this learner started.",
            ),
            Metric(
                "unpublished_policy",
                "unpublished_policy_chunks_total",
                "Chunks, since this learner started, driven by a policy newer than its newest.",
            ),
        ),
    ),
    Group(
        "learner intake",
        "athrl_learner_",
        (
            Metric("intake/stored", "intake_stored_chunks_total", "Chunks of the run that were taken in."),
            Metric("intake/refused", "intake_refused_chunks_total", "Chunks of the run that did not fit it."),
            Metric(
                "intake/lost",
                "intake_lost_chunks_total",
                "Chunks of the run that were never taken in and that their actor no longer holds.",
            ),
            Metric("intake/chunks", "intake_chunks_total", "Chunks taken in."),
            Metric("intake/transitions", "intake_transitions_total", "Transitions taken in."),
            Metric(
                "intake/duplicates",
                "intake_duplicate_chunks_total",
                "Chunks that arrived again, and were acknowledged again.",
            ),
            Metric(
                "intake/gaps",
                "intake_early_chunks_total",
                "Chunks that arrived before an earlier one, such as behind one that was told to wait.",
            ),
            Metric(
                "intake/busy",
                "intake_busy_chunks_total",
                "Chunks sent back for lack of room; sent again later, no loss.",
            ),
            Metric("intake/invalid", "intake_invalid_chunks_total", "Chunks refused for good."),
            Metric(
                "intake/invalid/REASON",
                "intake_invalid_chunks_by_reason_total",
                "Chunks refused for good, by reason.",
            ),
            Metric(
                "intake/active_actors",
                "intake_active_actors",
                "Actors that were heard in the last ten seconds.",
            ),
        ),
    ),
    Group(
        "learner losses",
        "athrl_learner_",
        (
            Metric(
                "loss/LEVEL/critic_loss",
                "critic_loss",
                "Loss of a level's critics; of a distributional critic a cross entropy.",
            ),
            Metric("loss/LEVEL/td_error", "td_error", "Mean absolute TD error of a level."),
            Metric("loss/LEVEL/value", "value", "Mean value of a level's first critic."),
            Metric(
                "loss/LEVEL/actor_loss",
                "actor_loss",
                "The negative value of what a level's actor would do.",
            ),
            Metric(
                "loss/LEVEL/saturated",
                "saturated_ratio",
                "Share of a level's actor's outputs beyond ±2 before the tanh.",
            ),
            Metric(
                "loss/critic_gradient",
                "critic_gradient",
                "Norm of all levels' gradients of critics before they are clipped.",
            ),
            Metric(
                "loss/actor_gradient",
                "actor_gradient",
                "The same of actors, of the updates in which they learn.",
            ),
        ),
    ),
    Group(
        "learner durability",
        "athrl_learner_",
        (
            Metric(
                "checkpoints_written",
                "checkpoints_written_total",
                "Checkpoints written since this learner started.",
            ),
            Metric(
                "checkpoints_failed",
                "checkpoints_failed_total",
                "Checkpoints that could not be written since this learner started.",
            ),
            Metric("disk/free_bytes", "disk_free_bytes", "Free space where the run's folder is."),
            Metric(
                "disk/reserved_bytes",
                "disk_reserved_bytes",
                "Free space that is kept for checkpoints: with less, intake pauses.",
            ),
            Metric("log/bytes", "log_bytes", "Size of the log of experience."),
            Metric(
                "log/recovered",
                "log_recovered_chunks",
                "Chunks taken in from the log at the start, beyond the checkpoint.",
            ),
            Metric(
                "log/damaged",
                "log_damaged_records",
                "Records of the log that could not be read, in the run.",
            ),
        ),
    ),
)
"""What the learner reports, and shows at its endpoint."""
