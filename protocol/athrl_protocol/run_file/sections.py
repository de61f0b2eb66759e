"""The sections of a run file: every setting with its default, its unit and its bounds.

The learner owns the run file and serves it, so all services read the same one; that is why it belongs to the
protocol. The description of a setting is also its comment in the default run file and its line in the
reference page.
"""

from __future__ import annotations

from typing import Any, Literal

from athrl_spaces.environment import BOUNDS
from pydantic import Field, field_validator

from athrl_protocol.errors import ProtocolError
from athrl_protocol.monitoring.address import EXPECTED as EXPECTED_METRICS_ADDRESS
from athrl_protocol.monitoring.address import metrics_address
from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.towns import EXPECTED, EXPECTED_CHECKSUMS, MOST_TOWNS, MapChecksums, Towns
from athrl_protocol.transport.address import split_address

LONGEST_SECONDS = 1e9
"""Thirty years; the clocks of Python and Zenoh take no waiting time that is much longer."""
MOST_STEPS = 2**63 - 1
"""Messages have integers of 64 bits."""
MOST_KEPT = 1_000_000
"""Of what is kept or listed one by one."""


def _bounded(key: str, default: float, description: str) -> Any:
    """A setting of the environment, with the environment's own bounds."""
    _, low, high = BOUNDS[key]
    return Field(default=default, ge=low, le=high, description=description)


class RunSection(Section):
    """The run as a whole."""

    name: str = Field(
        default="town03",
        pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$",
        description="Name of the run and of its folder.",
        json_schema_extra={
            "expected": "a name of at most 63 characters: a-z, 0-9, _ and -, not _ or - first"
        },
    )
    seed: int = Field(
        default=1,
        ge=0,
        lt=2**32,
        description="Root of the tree of seeds: run, service, environment, episode.",
    )
    environment_steps: int = Field(
        default=600_000,
        ge=1,
        le=MOST_STEPS,
        description="Decisions of all actors together after which the run ends.",
    )
    folder: str = Field(default="runs", min_length=1, description="Folder that holds the run's folder.")
    map_checksums: MapChecksums = Field(
        default={},
        description="SHA-256 of each map in environment.towns, noted when the run is started; other maps "
        "under these paths are refused.",
        json_schema_extra={"expected": EXPECTED_CHECKSUMS},
    )


class EnvironmentSection(Section):
    """The towns and the observation."""

    towns: Towns = Field(
        default={"town03": 1.0},
        description="Towns to drive in: town02, town03, town04, a random one as random-7, or the path of "
        "an OpenDRIVE file, PATH.xodr; up to "
        f"{MOST_TOWNS} with their shares of an actor's environments, "
        "{town03 = 2.0, town04 = 1.0}.",
        json_schema_extra={"expected": EXPECTED},
    )
    strict_map: bool = Field(
        default=False,
        description="Refuse a map with a fault that OpenDRIVE forbids; false: small ones are bridged, with a "
        "warning.",
    )
    vehicles: int = _bounded("vehicles", 100, "Background vehicles.")
    image_size: int = _bounded("image_size", 32, "Height and width of bird's eye view and lidar, pixels.")
    episode_ticks: int = _bounded("episode_ticks", 500, "Ticks of 0.1 s after which an episode is truncated.")
    ticks_per_decision: int = _bounded(
        "ticks_per_decision", 4, "Ticks of 0.1 s for which a decision is applied."
    )
    maximum_speed: float = _bounded(
        "maximum_speed", 7.95, "Highest target speed, m/s; above 8 m/s every tick costs 10 points."
    )
    waypoint_radius: float = _bounded("waypoint_radius", 8.0, "Distance of the planner's waypoint, m.")
    waypoint_half_angle: float = _bounded(
        "waypoint_half_angle",
        30.0,
        "Largest angle of the waypoint from straight ahead, degrees.",
    )
    speed_gain: float = _bounded(
        "speed_gain",
        2.0,
        "Acceleration towards the target speed for each m/s that is missing, 1/s; of planners that decide a "
        "waypoint. 0.7 is the authors' release.",
    )


class ExplorationSection(Section):
    """How actors explore; the noise is a setting of the planner."""

    random_decisions: int = Field(
        default=10_000,
        ge=0,
        le=MOST_STEPS,
        description="Warm-up: decisions of a uniformly random policy before training, at most a third of "
        "the run; the paper uses 10000. Actors wait near that for training to begin (several drive more).",
    )
    final_noise_scale: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Factor on all noise at the end of the run; it falls linearly from 1.",
    )


class ReplaySection(Section):
    """The replay buffer."""

    capacity: int = Field(
        default=200_000,
        ge=100,
        le=MOST_STEPS,
        description="Decisions that the replay buffer holds, if their sequences are full.",
    )
    sequence_length: int = Field(
        default=16, ge=2, le=256, description="Decisions in a sequence, the unit of the replay."
    )
    burn_in: int = Field(
        default=0,
        ge=0,
        le=128,
        description="Burn-in, only with a memory: first decisions of a sequence, which update its state "
        "alone; as sequences do not overlap, they are trained on nowhere else.",
    )
    prioritised: bool = Field(
        default=False,
        description="Prioritised replay: larger errors are sampled more often; false: uniform.",
    )
    priority_exponent: float = Field(
        default=0.6, ge=0, le=1, description="Prioritised: exponent of the error in the priority; 0: uniform."
    )
    importance_exponent: float = Field(
        default=0.4,
        ge=0,
        le=1,
        description="Prioritised: exponent of the importance weights; 1: full correction.",
    )


class LearnerSection(Section):
    """Training, publication, checkpoints."""

    batch: int = Field(
        default=512,
        ge=1,
        le=65_536,
        description="Decisions in an update; with a memory as whole sequences.",
    )
    samples_per_insert: float = Field(
        default=8.0,
        gt=0,
        le=10_000,
        description="How often a decision is trained on, on average; the limiter enforces it. A batch counts "
        "whole, with padding: an update is due every batch / samples_per_insert decisions.",
    )
    samples_per_insert_tolerance: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="By how much of the samples that the warm-up would be due actors or learner may lead "
        "before they wait.",
    )
    publish_seconds: float = Field(
        default=1.0, gt=0, le=LONGEST_SECONDS, description="Seconds between published policies."
    )
    checkpoint_seconds: float = Field(
        default=120.0, gt=0, le=LONGEST_SECONDS, description="Seconds between checkpoints."
    )
    checkpoints_kept: int = Field(
        default=3, ge=1, le=MOST_KEPT, description="Number of newest checkpoints that are kept."
    )
    deadlock_seconds: float = Field(
        default=60.0,
        gt=0,
        le=LONGEST_SECONDS,
        description="Seconds that actors and learner may wait for each other before the run ends with an "
        "error.",
    )
    threads: int = Field(
        default=0, ge=0, le=256, description="Training threads; 0: one for each available core."
    )
    device: Literal["cpu", "cuda", "auto"] = Field(
        default="cpu", description="Device of training; auto: a GPU if there is one."
    )
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        default="auto",
        description="Precision of matrix products; auto: bfloat16 if it is faster on this machine.",
    )


class DurabilitySection(Section):
    """The log of experience, which stores all acknowledged chunks."""

    fsync: Literal["never", "acknowledgement", "interval"] = Field(
        default="interval",
        description="When the log is synced to the disk, to survive a power cut: never, before each "
        "acknowledgement, or at an interval.",
    )
    fsync_seconds: float = Field(
        default=1.0,
        gt=0,
        le=LONGEST_SECONDS,
        description="The interval, seconds: most experience that a power cut can lose.",
    )
    segment_mebibytes: float = Field(
        default=32.0, gt=0, le=1024, description="Size of a segment (a file of the log), MiB."
    )
    reserve_mebibytes: float = Field(
        default=256.0,
        ge=0,
        le=1e9,
        description="Disk space reserved for checkpoints, MiB; with less free space, intake pauses.",
    )


class ActorSection(Section):
    """Settings of each actor."""

    environments: int = Field(
        default=64, ge=1, le=1024, description="Environments that an actor drives in parallel."
    )
    unacknowledged_chunks: int = Field(
        default=256,
        ge=1,
        le=MOST_KEPT,
        description="Most chunks that an actor keeps while the learner is away; then it waits.",
    )
    sequences_per_chunk: int = Field(
        default=8,
        ge=1,
        le=128,
        description="Most sequences in a chunk; after a second it is sent with fewer.",
    )
    policy_lag_versions: int = Field(
        default=30,
        ge=1,
        le=MOST_KEPT,
        description="Largest policy lag of an actor, versions; beyond it the actor waits for a newer policy.",
    )
    stall_seconds: float = Field(
        default=60.0,
        gt=0,
        le=LONGEST_SECONDS,
        description="Seconds for one step of the environments; if it takes longer, they are made again.",
    )
    failures_allowed: int = Field(
        default=5,
        ge=0,
        le=MOST_KEPT,
        description="Failures of environments (errors or stalls) in ten minutes before the actor ends.",
    )


class EvaluatorSection(Section):
    """Settings of the evaluator."""

    episodes: int = Field(
        default=8,
        ge=2,
        le=MOST_KEPT,
        description="Greedy episodes for each policy that is scored during training.",
    )
    final_episodes: int = Field(
        default=40, ge=2, le=MOST_KEPT, description="Episodes for each driver in the closing comparison."
    )
    seconds_between: float = Field(
        default=60.0, ge=0, le=LONGEST_SECONDS, description="Least seconds between two scored policies."
    )
    seed: int = Field(
        default=1_000_000,
        ge=0,
        lt=2**32,
        description="Seed of the first episode; later episodes have the following seeds.",
    )
    recordings_kept: int = Field(
        default=50, ge=1, le=MOST_KEPT, description="Number of newest recorded episodes (MCAP) that are kept."
    )


class SerialSection(Section):
    """A run in one process that is repeatable bit for bit."""

    enabled: bool = Field(
        default=False,
        description="Drive and train alternately in one process, without a network; `athrl train --serial`.",
    )
    updates_per_second: float = Field(
        default=20.0,
        gt=0,
        le=1_000_000,
        description="Updates that replace a second in other settings, since a serial run uses no clock.",
    )
    trace_updates: int = Field(
        default=200,
        ge=1,
        le=MOST_STEPS,
        description="Updates between two fingerprints of all parameters in trace.txt.",
    )


class NetworkSection(Section):
    """The network."""

    listen: str = Field(
        default="tcp/127.0.0.1:7447",
        pattern=r"^(tcp|tls)/.+:\d+$",
        description="The learner's address in Zenoh's form; with certificates, tcp means tls.",
        json_schema_extra={"expected": "tcp/HOST:PORT or tls/HOST:PORT"},
    )
    certificates: str = Field(
        default="",
        description="Folder of the services' certificates, made by `athrl certificates`; empty: the one in "
        "ATHRL_CERTIFICATES, or without it no encryption and no authentication.",
    )
    compression: Literal["lz4", "zstd", "none"] = Field(
        default="lz4",
        description="Compression of images on the network and in the log. zstd: half the bytes of lz4 for "
        "twice the work; none: ten times the bytes, for one machine.",
    )
    patience: float = Field(
        default=30.0,
        gt=0,
        le=LONGEST_SECONDS,
        description="Seconds after which an actor logs that no policy has arrived, or that the learner takes "
        "nothing.",
    )

    @field_validator("listen")
    @classmethod
    def _check_listen(cls, listen: str) -> str:
        try:
            split_address(listen)
        except ProtocolError as error:
            raise ValueError(str(error)) from None
        return listen


class MetricsSection(Section):
    """Metrics for Prometheus."""

    listen: str = Field(
        default="",
        description="Where the learner answers Prometheus, for instance 9464; empty: nowhere, as in a serial "
        "run.",
        json_schema_extra={"expected": EXPECTED_METRICS_ADDRESS},
    )

    @field_validator("listen")
    @classmethod
    def _check_listen(cls, listen: str) -> str:
        try:
            if listen:
                metrics_address(listen)
        except ProtocolError as error:
            raise ValueError(str(error)) from None
        return listen
