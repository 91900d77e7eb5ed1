"""Definitions of the ROS 2 messages of a trajectory, as MCAP files carry them."""

from __future__ import annotations

_SEPARATOR = "\n" + 80 * "=" + "\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_DURATION = "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_TRANSFORM = "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
_STAMPED = (
    "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform"
)
_POINT = (
    "MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\nfloat64[] velocities\nfloat64[] accelerations\n"
    "float64[] effort\nbuiltin_interfaces/Duration time_from_start"
)

STRING, JOINT_STATE, JOINT_TRAJECTORY, TRANSFORMS = (
    "std_msgs/msg/String",
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
    "tf2_msgs/msg/TFMessage",
)
DEFINITIONS = {
    STRING: "string data",
    JOINT_STATE: _SEPARATOR.join((
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        _HEADER,
        _TIME,
    )),
    JOINT_TRAJECTORY: _SEPARATOR.join((
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points",
        _HEADER,
        _TIME,
        _POINT,
        _DURATION,
    )),
    TRANSFORMS: _SEPARATOR.join((
        "geometry_msgs/TransformStamped[] transforms", _STAMPED, _HEADER, _TIME, _TRANSFORM, _VECTOR, _QUATERNION,
    )),
}  # fmt: skip
"""Definition of each type, with the definitions of the types in it."""
