"""The town's geometry for kernels that take the lanes by reference; the same code as Python's."""

from athrl_driving.kernels.compilation import part
from athrl_driving.maps import geometry

lane_pose = part(geometry.lane_pose.py_func)  # type: ignore[attr-defined]
lane_project = part(geometry.lane_project.py_func)  # type: ignore[attr-defined]
lane_elevation = part(geometry.lane_elevation.py_func)  # type: ignore[attr-defined]
