from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Level(_message.Message):
    __slots__ = ("name", "action_size", "actions", "rewards", "states")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ACTION_SIZE_FIELD_NUMBER: _ClassVar[int]
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    REWARDS_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    name: str
    action_size: int
    actions: bytes
    rewards: bytes
    states: bytes
    def __init__(self, name: _Optional[str] = ..., action_size: _Optional[int] = ..., actions: _Optional[bytes] = ..., rewards: _Optional[bytes] = ..., states: _Optional[bytes] = ...) -> None: ...

class Chunk(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "actor", "incarnation", "sequence", "environment", "episode_seed", "first_step", "time", "length", "image_height", "image_width", "image_channels", "motion_size", "images", "motion", "levels", "policy_version", "terminated", "truncated", "oldest_held", "image_compression", "state_interval")
    class Compression(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        ZSTD: _ClassVar[Chunk.Compression]
        LZ4: _ClassVar[Chunk.Compression]
        NONE: _ClassVar[Chunk.Compression]
    ZSTD: Chunk.Compression
    LZ4: Chunk.Compression
    NONE: Chunk.Compression
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    ACTOR_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_FIELD_NUMBER: _ClassVar[int]
    EPISODE_SEED_FIELD_NUMBER: _ClassVar[int]
    FIRST_STEP_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    IMAGE_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    IMAGE_WIDTH_FIELD_NUMBER: _ClassVar[int]
    IMAGE_CHANNELS_FIELD_NUMBER: _ClassVar[int]
    MOTION_SIZE_FIELD_NUMBER: _ClassVar[int]
    IMAGES_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    POLICY_VERSION_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    OLDEST_HELD_FIELD_NUMBER: _ClassVar[int]
    IMAGE_COMPRESSION_FIELD_NUMBER: _ClassVar[int]
    STATE_INTERVAL_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    actor: str
    incarnation: int
    sequence: int
    environment: int
    episode_seed: int
    first_step: int
    time: int
    length: int
    image_height: int
    image_width: int
    image_channels: int
    motion_size: int
    images: bytes
    motion: bytes
    levels: _containers.RepeatedCompositeFieldContainer[Level]
    policy_version: bytes
    terminated: bool
    truncated: bool
    oldest_held: int
    image_compression: Chunk.Compression
    state_interval: int
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., actor: _Optional[str] = ..., incarnation: _Optional[int] = ..., sequence: _Optional[int] = ..., environment: _Optional[int] = ..., episode_seed: _Optional[int] = ..., first_step: _Optional[int] = ..., time: _Optional[int] = ..., length: _Optional[int] = ..., image_height: _Optional[int] = ..., image_width: _Optional[int] = ..., image_channels: _Optional[int] = ..., motion_size: _Optional[int] = ..., images: _Optional[bytes] = ..., motion: _Optional[bytes] = ..., levels: _Optional[_Iterable[_Union[Level, _Mapping]]] = ..., policy_version: _Optional[bytes] = ..., terminated: _Optional[bool] = ..., truncated: _Optional[bool] = ..., oldest_held: _Optional[int] = ..., image_compression: _Optional[_Union[Chunk.Compression, str]] = ..., state_interval: _Optional[int] = ...) -> None: ...

class Delivery(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "sizes")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    SIZES_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    sizes: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., sizes: _Optional[_Iterable[int]] = ...) -> None: ...

class Acknowledgement(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "next_sequence", "credits")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    CREDITS_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    next_sequence: int
    credits: int
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., next_sequence: _Optional[int] = ..., credits: _Optional[int] = ...) -> None: ...

class Refusal(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "reason", "expected_sequence", "text", "index")
    class Reason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNSPECIFIED: _ClassVar[Refusal.Reason]
        BUSY: _ClassVar[Refusal.Reason]
        EXPECTED: _ClassVar[Refusal.Reason]
        INVALID: _ClassVar[Refusal.Reason]
        FINISHED: _ClassVar[Refusal.Reason]
    UNSPECIFIED: Refusal.Reason
    BUSY: Refusal.Reason
    EXPECTED: Refusal.Reason
    INVALID: Refusal.Reason
    FINISHED: Refusal.Reason
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    reason: Refusal.Reason
    expected_sequence: int
    text: str
    index: int
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., reason: _Optional[_Union[Refusal.Reason, str]] = ..., expected_sequence: _Optional[int] = ..., text: _Optional[str] = ..., index: _Optional[int] = ...) -> None: ...

class Version(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "incarnation", "number", "reminder")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    REMINDER_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    incarnation: int
    number: int
    reminder: bool
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., incarnation: _Optional[int] = ..., number: _Optional[int] = ..., reminder: _Optional[bool] = ...) -> None: ...

class RunFile(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "run", "json")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    JSON_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    run: str
    json: str
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., run: _Optional[str] = ..., json: _Optional[str] = ...) -> None: ...

class Policy(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "version", "artefact", "sha256", "uniform_exploration", "noise_scale", "updates", "environment_steps", "published_at")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    ARTEFACT_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    UNIFORM_EXPLORATION_FIELD_NUMBER: _ClassVar[int]
    NOISE_SCALE_FIELD_NUMBER: _ClassVar[int]
    UPDATES_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_STEPS_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_AT_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    version: int
    artefact: bytes
    sha256: bytes
    uniform_exploration: bool
    noise_scale: float
    updates: int
    environment_steps: int
    published_at: float
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., version: _Optional[int] = ..., artefact: _Optional[bytes] = ..., sha256: _Optional[bytes] = ..., uniform_exploration: _Optional[bool] = ..., noise_scale: _Optional[float] = ..., updates: _Optional[int] = ..., environment_steps: _Optional[int] = ..., published_at: _Optional[float] = ...) -> None: ...

class RunState(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "phase", "environment_steps", "environment_steps_target", "updates", "policy_version", "waiting")
    class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNSPECIFIED: _ClassVar[RunState.Phase]
        WARMING_UP: _ClassVar[RunState.Phase]
        TRAINING: _ClassVar[RunState.Phase]
        DRAINING: _ClassVar[RunState.Phase]
        FINISHED: _ClassVar[RunState.Phase]
    UNSPECIFIED: RunState.Phase
    WARMING_UP: RunState.Phase
    TRAINING: RunState.Phase
    DRAINING: RunState.Phase
    FINISHED: RunState.Phase
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_STEPS_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_STEPS_TARGET_FIELD_NUMBER: _ClassVar[int]
    UPDATES_FIELD_NUMBER: _ClassVar[int]
    POLICY_VERSION_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    phase: RunState.Phase
    environment_steps: int
    environment_steps_target: int
    updates: int
    policy_version: int
    waiting: str
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., phase: _Optional[_Union[RunState.Phase, str]] = ..., environment_steps: _Optional[int] = ..., environment_steps_target: _Optional[int] = ..., updates: _Optional[int] = ..., policy_version: _Optional[int] = ..., waiting: _Optional[str] = ...) -> None: ...

class Metrics(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "role", "name", "time", "values")
    class ValuesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    role: str
    name: str
    time: float
    values: _containers.ScalarMap[str, float]
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., role: _Optional[str] = ..., name: _Optional[str] = ..., time: _Optional[float] = ..., values: _Optional[_Mapping[str, float]] = ...) -> None: ...

class Evaluation(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "driver", "policy_version", "environment_steps", "town", "seed", "scores")
    class ScoresEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    DRIVER_FIELD_NUMBER: _ClassVar[int]
    POLICY_VERSION_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_STEPS_FIELD_NUMBER: _ClassVar[int]
    TOWN_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    SCORES_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    driver: str
    policy_version: int
    environment_steps: int
    town: str
    seed: int
    scores: _containers.ScalarMap[str, float]
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., driver: _Optional[str] = ..., policy_version: _Optional[int] = ..., environment_steps: _Optional[int] = ..., town: _Optional[str] = ..., seed: _Optional[int] = ..., scores: _Optional[_Mapping[str, float]] = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("schema_version", "schema_hash", "driver", "town", "policy_version", "episode_seed", "step", "time", "ego", "vehicles", "route", "waypoint", "target_speed", "decision", "steering", "acceleration", "reward", "reward_terms", "episode_return", "image_height", "image_width", "birdeye", "lidar")
    class DecisionEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class RewardTermsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_HASH_FIELD_NUMBER: _ClassVar[int]
    DRIVER_FIELD_NUMBER: _ClassVar[int]
    TOWN_FIELD_NUMBER: _ClassVar[int]
    POLICY_VERSION_FIELD_NUMBER: _ClassVar[int]
    EPISODE_SEED_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    EGO_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    ROUTE_FIELD_NUMBER: _ClassVar[int]
    WAYPOINT_FIELD_NUMBER: _ClassVar[int]
    TARGET_SPEED_FIELD_NUMBER: _ClassVar[int]
    DECISION_FIELD_NUMBER: _ClassVar[int]
    STEERING_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_FIELD_NUMBER: _ClassVar[int]
    REWARD_FIELD_NUMBER: _ClassVar[int]
    REWARD_TERMS_FIELD_NUMBER: _ClassVar[int]
    EPISODE_RETURN_FIELD_NUMBER: _ClassVar[int]
    IMAGE_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    IMAGE_WIDTH_FIELD_NUMBER: _ClassVar[int]
    BIRDEYE_FIELD_NUMBER: _ClassVar[int]
    LIDAR_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    schema_hash: int
    driver: str
    town: str
    policy_version: int
    episode_seed: int
    step: int
    time: float
    ego: Vehicle
    vehicles: _containers.RepeatedCompositeFieldContainer[Vehicle]
    route: _containers.RepeatedCompositeFieldContainer[Point]
    waypoint: Point
    target_speed: float
    decision: _containers.ScalarMap[str, float]
    steering: float
    acceleration: float
    reward: float
    reward_terms: _containers.ScalarMap[str, float]
    episode_return: float
    image_height: int
    image_width: int
    birdeye: bytes
    lidar: bytes
    def __init__(self, schema_version: _Optional[int] = ..., schema_hash: _Optional[int] = ..., driver: _Optional[str] = ..., town: _Optional[str] = ..., policy_version: _Optional[int] = ..., episode_seed: _Optional[int] = ..., step: _Optional[int] = ..., time: _Optional[float] = ..., ego: _Optional[_Union[Vehicle, _Mapping]] = ..., vehicles: _Optional[_Iterable[_Union[Vehicle, _Mapping]]] = ..., route: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., waypoint: _Optional[_Union[Point, _Mapping]] = ..., target_speed: _Optional[float] = ..., decision: _Optional[_Mapping[str, float]] = ..., steering: _Optional[float] = ..., acceleration: _Optional[float] = ..., reward: _Optional[float] = ..., reward_terms: _Optional[_Mapping[str, float]] = ..., episode_return: _Optional[float] = ..., image_height: _Optional[int] = ..., image_width: _Optional[int] = ..., birdeye: _Optional[bytes] = ..., lidar: _Optional[bytes] = ...) -> None: ...

class Point(_message.Message):
    __slots__ = ("x", "y")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ...) -> None: ...

class Vehicle(_message.Message):
    __slots__ = ("x", "y", "heading", "speed", "length", "width")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    heading: float
    speed: float
    length: float
    width: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., heading: _Optional[float] = ..., speed: _Optional[float] = ..., length: _Optional[float] = ..., width: _Optional[float] = ...) -> None: ...
