"""Converts a frame to Foxglove's well-known messages, for programs that do not know `Frame`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from athrl_protocol import Frame, Point, Vehicle
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

TOWN_FRAME = "town"  # metres, highway-env's axes: y grows to the right of a driver who looks along x
CAR_FRAME = "car"  # of the images


def foxglove_messages(frame: Frame, log_time: int) -> Iterator[tuple[str, Message]]:
    """Yield (topic, message) for a frame; `log_time` is in nanoseconds."""
    stamp = Timestamp(seconds=log_time // 10**9, nanos=log_time % 10**9)
    width, height = frame.image_width, frame.image_height
    yield "/birdeye", _image(stamp, "rgb8", 3, width, height, frame.birdeye)
    yield "/lidar", _image(stamp, "mono8", 1, width, height, frame.lidar)
    yield "/ego", PoseInFrame(timestamp=stamp, frame_id=TOWN_FRAME, pose=_vehicle_pose(frame.ego))
    yield "/vehicles", _poses(stamp, (_vehicle_pose(vehicle) for vehicle in frame.vehicles))
    yield "/route", _poses(stamp, (_point_pose(point) for point in frame.route))
    if frame.HasField("waypoint"):
        yield "/waypoint", PoseInFrame(timestamp=stamp, frame_id=TOWN_FRAME, pose=_point_pose(frame.waypoint))


def _image(stamp: Timestamp, encoding: str, channels: int, width: int, height: int, data: bytes) -> RawImage:
    return RawImage(
        timestamp=stamp,
        frame_id=CAR_FRAME,
        width=width,
        height=height,
        encoding=encoding,
        step=width * channels,
        data=data,
    )


def _poses(stamp: Timestamp, poses: Iterable[Pose]) -> PosesInFrame:
    return PosesInFrame(timestamp=stamp, frame_id=TOWN_FRAME, poses=poses)


def _vehicle_pose(vehicle: Vehicle) -> Pose:
    pose = Pose()
    pose.position.x, pose.position.y = vehicle.x, vehicle.y
    pose.orientation.z, pose.orientation.w = math.sin(vehicle.heading / 2), math.cos(vehicle.heading / 2)
    return pose


def _point_pose(point: Point) -> Pose:
    pose = Pose()
    pose.position.x, pose.position.y = point.x, point.y
    pose.orientation.w = 1.0
    return pose
