"""Names of topics, without the robot's prefix."""

from __future__ import annotations

from orbit_deploy.description import RobotDescription

JOINT_STATES = "joint_states"
CLOCK = "clock"
TF = "tf"
TF_STATIC = "tf_static"
ODOMETRY = "odom"
IMU = "imu/data"
CAMERA_INFO = "camera_info"
TWIST = "cmd_vel"
DESCRIPTION = "orbit/description"
FAULTS = "orbit/faults"
CLEAR = "orbit/clear"
STOP = "orbit/stop"
COMMANDS = {
    "trajectory": "joint_trajectory_controller/joint_trajectory",
    "positions": "position_controller/commands",
    "velocities": "velocity_controller/commands",
    "efforts": "effort_controller/commands",
    "twist": TWIST,
}
"""Topics of commands by their kind, as ros2_control's controllers are usually named."""
WORLD = "world"
"""Frame of poses."""
BASE = "base"
"""Frame of a robot that walks or drives."""
# Name of the robot among the bodies that a robot's computer tracks
_ROBOT = "robot"


def base_of(description: RobotDescription) -> str:
    """Return the name of the tracked body that is the robot itself; empty if its base is fixed."""
    return next((name for name in description.objects if name in (_ROBOT, description.model)), "")


def body_topic(name: str, description: RobotDescription) -> str:
    """Return the topic of a tracked body's odometry."""
    return ODOMETRY if name == base_of(description) else f"objects/{name}"


def color_topic(camera: str) -> str:
    """Return the topic of a camera's colour pictures."""
    return f"{camera}/image_raw"


def depth_topic(camera: str) -> str:
    """Return the topic of a camera's depth pictures."""
    return f"{camera}/depth/image_raw"
