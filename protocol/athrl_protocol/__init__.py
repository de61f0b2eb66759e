"""Communication between the services of a run: messages, keys, sessions, delivery, the run file."""

from athrl_protocol.announcements import (
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    RunState,
    StatePublisher,
    StateSubscriber,
    fetch_run_file,
    serve_run_file,
)
from athrl_protocol.announcements.joining import join_run
from athrl_protocol.announcements.latest_value import LatestPublisher, LatestSubscriber
from athrl_protocol.announcements.live_frames import FramePublisher, FrameSubscription, subscribe_frames
from athrl_protocol.announcements.metrics import MetricsPublisher, MetricsReport, MetricsSubscriber
from athrl_protocol.announcements.presence import Presence, PresenceWatcher, announce_presence
from athrl_protocol.announcements.rivals import RivalWatch
from athrl_protocol.codec.chunks import decode_chunk, encode_chunk
from athrl_protocol.delivery.intake import ChunkIntake, IntakeStatistics
from athrl_protocol.delivery.receiver import IntakeBusy, IntakeFinished
from athrl_protocol.delivery.upload import ChunkUploader
from athrl_protocol.delivery.upload_window import UploadStatistics
from athrl_protocol.errors import (
    AddressInUse,
    BackgroundFailed,
    InvalidMessage,
    LearnerNotFound,
    NameTaken,
    NotAdmitted,
    ProtocolError,
    RunFileError,
    RunNotFound,
)
from athrl_protocol.messages.chunk import Chunk, LevelColumns, check_chunk
from athrl_protocol.messages.frame import Frame, Point, Vehicle, decode_frame, encode_frame
from athrl_protocol.messages.keys import Keys, check_name, new_incarnation
from athrl_protocol.messages.schema import SCHEMA_HASH, SCHEMA_VERSION
from athrl_protocol.run_file import RunFile, default_toml, read_run_file, to_toml
from athrl_protocol.transport.address import complete_address
from athrl_protocol.transport.session import open_session

__all__ = [
    "SCHEMA_HASH",
    "SCHEMA_VERSION",
    "AddressInUse",
    "BackgroundFailed",
    "Chunk",
    "ChunkIntake",
    "ChunkUploader",
    "EvaluationPublisher",
    "EvaluationResult",
    "EvaluationSubscriber",
    "Frame",
    "FramePublisher",
    "FrameSubscription",
    "IntakeBusy",
    "IntakeFinished",
    "IntakeStatistics",
    "InvalidMessage",
    "Keys",
    "LatestPublisher",
    "LatestSubscriber",
    "LearnerNotFound",
    "LevelColumns",
    "MetricsPublisher",
    "MetricsReport",
    "MetricsSubscriber",
    "NameTaken",
    "NotAdmitted",
    "Phase",
    "Point",
    "PolicyPublisher",
    "PolicySubscriber",
    "PolicyUpdate",
    "Presence",
    "PresenceWatcher",
    "ProtocolError",
    "RivalWatch",
    "RunFile",
    "RunFileError",
    "RunNotFound",
    "RunState",
    "StatePublisher",
    "StateSubscriber",
    "UploadStatistics",
    "Vehicle",
    "announce_presence",
    "check_chunk",
    "check_name",
    "complete_address",
    "decode_chunk",
    "decode_frame",
    "default_toml",
    "encode_chunk",
    "encode_frame",
    "fetch_run_file",
    "join_run",
    "new_incarnation",
    "open_session",
    "read_run_file",
    "serve_run_file",
    "subscribe_frames",
    "to_toml",
]
