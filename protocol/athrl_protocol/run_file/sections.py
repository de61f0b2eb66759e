"""The sections of a run file: every setting with its default, its unit and its bounds.

The learner owns the run file and serves it, so every service reads the same one; that is why it lives
with the protocol. A setting's description is also the comment in the default run file and the line in
the reference page.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Section(BaseModel):
    """A table of the run file; unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class RunSection(Section):
    """The run as a whole."""

    name: str = Field(
        default="town03",
        pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$",
        description="Name of the run and of its folder.",
    )
    seed: int = Field(
        default=1,
        ge=0,
        lt=2**32,
        description="Root of the tree of seeds: run, service, environment, episode.",
    )
    environment_steps: int = Field(
        default=30_000, ge=1, description="Decisions of all actors together after which the run ends."
    )
    folder: str = Field(default="runs", min_length=1, description="Folder that holds the run's folder.")


class EnvironmentSection(Section):
    """The town and what the car perceives."""

    town: str = Field(
        default="town03",
        pattern=r"^(town02|town03|town04|.+\.xodr)$",
        description="The town to drive in: town02, town03, town04, or an OpenDRIVE file of yours, PATH.xodr.",
    )
    vehicles: int = Field(default=100, ge=0, le=1000, description="Background vehicles.")
    image_size: Literal[32, 64] = Field(
        default=32, description="Height and width of bird's eye view and lidar, pixels."
    )
    episode_ticks: int = Field(
        default=500, ge=4, description="Ticks of 0.1 s after which an episode is truncated."
    )
    ticks_per_decision: int = Field(
        default=4, ge=1, le=50, description="Ticks of 0.1 s for which a decision holds."
    )
    maximum_speed: float = Field(
        default=7.95,
        gt=0,
        le=40,
        description="Highest target speed, m/s; above 8 m/s every tick costs 10 points.",
    )
    waypoint_radius: float = Field(
        default=8.0, ge=2, le=30, description="Distance of the planner's waypoint, m."
    )
    waypoint_half_angle: float = Field(
        default=30.0,
        gt=0,
        le=90,
        description="The waypoint lies within this angle to either side of straight ahead, degrees.",
    )


class PlannerSection(Section):
    """The hierarchical planner and how it learns."""

    kind: Literal["athrl"] = Field(
        default="athrl", description="athrl: intention planner over trajectory planner (the paper)."
    )
    hidden_features: int = Field(
        default=128, ge=8, le=2048, description="Width of the layer before the LSTM."
    )
    recurrent_features: int = Field(default=64, ge=4, le=1024, description="Units of each LSTM.")
    discount: float = Field(default=0.97, ge=0, lt=1, description="Discount of one decision.")
    learning_rate: float = Field(
        default=3e-4, gt=0, le=1, description="Adam's step size for actors and critics."
    )
    soft_target: float = Field(
        default=0.005, gt=0, le=1, description="Share of the online weights taken into the targets."
    )
    reward_scale: float = Field(
        default=0.02, gt=0, description="Factor on rewards before they reach the critics."
    )
    saturation_penalty: float = Field(
        default=0.02,
        ge=0,
        description="Weight of the squared pre-tanh output in the actors' loss; 0 is the paper.",
    )
    twin_critics: bool = Field(
        default=True, description="Two critics and the smaller value (TD3); false is the paper."
    )
    actor_delay: int = Field(
        default=2, ge=1, description="Critic updates for each actor update (TD3); 1 is the paper."
    )
    target_noise: float = Field(
        default=0.1, ge=0, le=1, description="Noise on target actions, in half-ranges (TD3); 0 is the paper."
    )
    intention_gradient: float = Field(
        default=1.0, ge=0, description="Weight of the trajectory critic's gradient through the intention."
    )
    gradient_norm: float = Field(default=10.0, gt=0, description="Gradients are clipped to this norm.")
    average_decay: float = Field(
        default=0.995,
        ge=0,
        lt=1,
        description="Decay of the averaged actor that is published; 0 publishes the newest.",
    )


class ExplorationSection(Section):
    """The actors' noise."""

    random_decisions: int = Field(
        default=2_000,
        ge=0,
        description="Decisions of a uniformly random policy before training starts; the paper has 10000.",
    )
    intention_noise: float = Field(
        default=0.2, ge=0, le=2, description="Ornstein-Uhlenbeck on the intention, half-ranges."
    )
    speed_noise: float = Field(
        default=0.2, ge=0, le=2, description="Ornstein-Uhlenbeck on the target speed, half-ranges."
    )
    waypoint_noise: float = Field(
        default=0.1, ge=0, le=2, description="Gaussian on the waypoint's angle, half-ranges."
    )
    damping: float = Field(default=0.15, gt=0, le=1, description="Damping of the Ornstein-Uhlenbeck process.")
    final_noise_scale: float = Field(
        default=0.5, ge=0, le=1, description="Factor on all noise at the run's end; it falls linearly from 1."
    )


class ReplaySection(Section):
    """The replay buffer."""

    capacity: int = Field(default=100_000, ge=100, description="Transitions that the replay buffer holds.")
    sequence_length: int = Field(
        default=10, ge=2, le=256, description="Decisions in a sequence, the unit of replay."
    )
    burn_in: int = Field(
        default=2,
        ge=0,
        le=128,
        description="First decisions of a sequence that only warm the recurrent states.",
    )


class LearnerSection(Section):
    """Training, publication, checkpoints."""

    batch: int = Field(default=16, ge=1, le=4096, description="Sequences in an update.")
    samples_per_insert: float = Field(
        default=32.0,
        gt=0,
        description="How often a transition is trained on, on average; the limiter holds to it.",
    )
    samples_per_insert_tolerance: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="Share by which samples per insert may be off before somebody waits.",
    )
    publish_seconds: float = Field(default=2.0, gt=0, description="Seconds between published policies.")
    checkpoint_seconds: float = Field(default=120.0, gt=0, description="Seconds between checkpoints.")
    checkpoints_kept: int = Field(default=3, ge=1, description="Newest checkpoints that are kept.")
    deadlock_seconds: float = Field(
        default=60.0,
        gt=0,
        description="Seconds that actors and learner may wait for each other "
        "before the run ends in an error.",
    )
    threads: int = Field(default=1, ge=1, le=256, description="Threads that train.")
    device: Literal["cpu", "cuda", "auto"] = Field(
        default="cpu", description="Where training happens; auto: on a GPU where there is one."
    )


class DurabilitySection(Section):
    """The log of experience, which keeps what was acknowledged."""

    fsync: Literal["never", "acknowledgement", "interval"] = Field(
        default="interval",
        description="When the log is brought to the disk, which only a power cut makes matter: never, before "
        "each acknowledgement, or at an interval.",
    )
    fsync_seconds: float = Field(
        default=1.0, gt=0, description="The interval: what a power cut may cost, seconds."
    )
    segment_mebibytes: float = Field(
        default=32.0, gt=0, le=1024, description="Size of a file of the log, after which the next one begins."
    )
    reserve_mebibytes: float = Field(
        default=256.0,
        ge=0,
        description="Room on the disk that is left for checkpoints; with less, experience has to wait.",
    )


class ActorSection(Section):
    """Each actor."""

    environments: int = Field(
        default=8, ge=1, le=1024, description="Environments that an actor drives in step."
    )
    unacknowledged_chunks: int = Field(
        default=64,
        ge=1,
        description="Chunks kept while the learner is away; when it is full the actor waits.",
    )
    sequences_per_chunk: int = Field(
        default=8,
        ge=1,
        le=128,
        description="Most sequences in a chunk, which go together; after a second it goes with fewer.",
    )
    policy_lag_versions: int = Field(
        default=30,
        ge=1,
        description="Versions by which an actor's policy may be behind; with more it waits for a newer one.",
    )
    stall_seconds: float = Field(
        default=60.0,
        gt=0,
        description="Seconds within which a step of the environments returns; else they are made anew.",
    )
    failures_allowed: int = Field(
        default=5,
        ge=0,
        description="Times in ten minutes that environments may raise or stall before the actor leaves.",
    )


class EvaluatorSection(Section):
    """The evaluator."""

    episodes: int = Field(
        default=8, ge=2, description="Greedy episodes for each policy that is scored while training."
    )
    final_episodes: int = Field(
        default=40, ge=2, description="Episodes for each driver in the closing comparison."
    )
    seconds_between: float = Field(
        default=60.0, ge=0, description="Shortest time between two scored policies, seconds."
    )
    seed: int = Field(
        default=1_000_000, ge=0, lt=2**32, description="Episodes have this seed and the ones after it."
    )
    recordings_kept: int = Field(
        default=50, ge=1, description="Newest recorded episodes (MCAP) that are kept."
    )


class SerialSection(Section):
    """A run in one process that repeats itself bit for bit."""

    enabled: bool = Field(
        default=False,
        description="Drive and train in turns in one process, without a network; `athrl train --serial`.",
    )
    updates_per_second: float = Field(
        default=20.0,
        gt=0,
        description="Updates that count as a second in settings; a serial run looks at no clock.",
    )
    trace_updates: int = Field(
        default=200, ge=1, description="Updates between two fingerprints of all parameters in trace.txt."
    )


class NetworkSection(Section):
    """Where the run listens."""

    listen: str = Field(
        default="tcp/127.0.0.1:7447",
        pattern=r"^(tcp|tls)/.+:\d+$",
        description="The learner's address, as Zenoh writes it; with certificates tcp stands for tls.",
    )
    certificates: str = Field(
        default="",
        description="Folder of the certificates by which services know each other, made by `athrl "
        "certificates`; empty: ATHRL_CERTIFICATES, or without any no encryption and no check.",
    )
    compression: Literal["lz4", "zstd", "none"] = Field(
        default="lz4",
        description="Of images on their way to the learner and in its log. zstd: half the bytes of lz4 for "
        "twice the work; none: ten times the bytes, for one machine.",
    )
    patience: float = Field(
        default=30.0,
        gt=0,
        description="Seconds that a service waits for an absent learner before it starts to complain.",
    )
