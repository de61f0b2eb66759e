"""The sections of a run file: every setting with its default, its unit and its bounds.

The learner owns the run file and serves it, so every service reads the same one; that is why it lives
with the protocol. A setting's description is also the comment in the default run file and the line in
the reference page.
"""

from __future__ import annotations

from typing import Any, Literal

from athrl_spaces.environment import BOUNDS
from pydantic import Field

from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.towns import EXPECTED, Towns


def _bounded(key: str, default: float, description: str) -> Any:
    """A setting of the environment, with the bounds that the environment itself has for it."""
    _, low, high = BOUNDS[key]
    return Field(default=default, ge=low, le=high, description=description)


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
        default=900_000, ge=1, description="Decisions of all actors together after which the run ends."
    )
    folder: str = Field(default="runs", min_length=1, description="Folder that holds the run's folder.")


class EnvironmentSection(Section):
    """The towns and what the car perceives."""

    towns: Towns = Field(
        default={"town03": 1.0},
        description="The towns to drive in: town02, town03, town04, or an OpenDRIVE file of yours, "
        "PATH.xodr; several with their shares of an actor's environments, {town03 = 2.0, town04 = 1.0}.",
        json_schema_extra={"expected": EXPECTED},
    )
    vehicles: int = _bounded("vehicles", 100, "Background vehicles.")
    image_size: int = _bounded("image_size", 32, "Height and width of bird's eye view and lidar, pixels.")
    episode_ticks: int = _bounded("episode_ticks", 500, "Ticks of 0.1 s after which an episode is truncated.")
    ticks_per_decision: int = _bounded("ticks_per_decision", 4, "Ticks of 0.1 s for which a decision holds.")
    maximum_speed: float = _bounded(
        "maximum_speed", 7.95, "Highest target speed, m/s; above 8 m/s every tick costs 10 points."
    )
    waypoint_radius: float = _bounded("waypoint_radius", 8.0, "Distance of the planner's waypoint, m.")
    waypoint_half_angle: float = _bounded(
        "waypoint_half_angle",
        30.0,
        "The waypoint lies within this angle to either side of straight ahead, degrees.",
    )


class ExplorationSection(Section):
    """How actors explore; the noise itself is a setting of the planner."""

    random_decisions: int = Field(
        default=10_000,
        ge=0,
        description="Decisions of a uniformly random policy before training starts, at most a third of the "
        "run; the paper has 10000.",
    )
    final_noise_scale: float = Field(
        default=0.5, ge=0, le=1, description="Factor on all noise at the run's end; it falls linearly from 1."
    )


class ReplaySection(Section):
    """The replay buffer."""

    capacity: int = Field(default=200_000, ge=100, description="Decisions that the replay buffer holds.")
    sequence_length: int = Field(
        default=16, ge=2, le=256, description="Decisions in a sequence, the unit in which they travel."
    )
    burn_in: int = Field(
        default=0,
        ge=0,
        le=128,
        description="First decisions of a sequence that only warm the recurrent states.",
    )
    prioritised: bool = Field(
        default=False,
        description="Draw what was predicted badly more often; false: everything equally often.",
    )
    priority_exponent: float = Field(
        default=0.6, ge=0, le=1, description="Prioritised: how much the error counts; 0: not at all."
    )
    importance_exponent: float = Field(
        default=0.4,
        ge=0,
        le=1,
        description="Prioritised: how far losses are weighted against being drawn more often; 1: fully.",
    )


class LearnerSection(Section):
    """Training, publication, checkpoints."""

    batch: int = Field(
        default=512,
        ge=1,
        le=65_536,
        description="Decisions in an update; a planner with memory takes them as whole sequences.",
    )
    samples_per_insert: float = Field(
        default=8.0,
        gt=0,
        description="How often a decision is trained on, on average; the limiter holds to it.",
    )
    samples_per_insert_tolerance: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="Share by which samples per insert may be off before somebody waits.",
    )
    publish_seconds: float = Field(default=1.0, gt=0, description="Seconds between published policies.")
    checkpoint_seconds: float = Field(default=120.0, gt=0, description="Seconds between checkpoints.")
    checkpoints_kept: int = Field(default=3, ge=1, description="Newest checkpoints that are kept.")
    deadlock_seconds: float = Field(
        default=60.0,
        gt=0,
        description="Seconds that actors and learner may wait for each other "
        "before the run ends in an error.",
    )
    threads: int = Field(
        default=0, ge=0, le=256, description="Threads that train; 0: as many as the run leaves it."
    )
    device: Literal["cpu", "cuda", "auto"] = Field(
        default="cpu", description="Where training happens; auto: on a GPU where there is one."
    )
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        default="auto",
        description="Of the networks' products; auto: bfloat16 where this machine's CPU is faster with it.",
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
        default=64, ge=1, le=1024, description="Environments that an actor drives in step."
    )
    unacknowledged_chunks: int = Field(
        default=256,
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
        description="Seconds within which a step of the environments returns; else they are made again.",
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
