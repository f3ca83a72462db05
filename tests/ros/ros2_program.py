"""Program of the real ROS 2 (rclpy): commands the arm by a trajectory, and measures round trips of an echo."""

from __future__ import annotations

import time

import rclpy  # pyright: ignore[reportMissingImports]
from builtin_interfaces.msg import Duration  # pyright: ignore[reportMissingImports]
from sensor_msgs.msg import JointState  # pyright: ignore[reportMissingImports]
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # pyright: ignore[reportMissingImports]

GOAL, SECONDS = -0.3, 20.0


def main() -> None:
    """Move joint2 to a goal and say so."""
    rclpy.init()
    node = rclpy.create_node("program")
    seen: list[float] = []
    node.create_subscription(
        JointState, "joint_states", lambda message: seen.append(message.position[message.name.index("joint2")]), 10
    )
    publisher = node.create_publisher(JointTrajectory, "joint_trajectory_controller/joint_trajectory", 10)
    goal = JointTrajectory(joint_names=["joint2"])
    goal.points = [JointTrajectoryPoint(positions=[GOAL], time_from_start=Duration(nanosec=500_000_000))]
    end, sent = time.monotonic() + SECONDS, 0.0
    while time.monotonic() < end and not (seen and abs(seen[-1] - GOAL) < 0.02):
        if seen and publisher.get_subscription_count() and time.monotonic() - sent > 3.0:
            publisher.publish(goal)
            sent = time.monotonic()
        rclpy.spin_once(node, timeout_sec=0.1)
    print("joint2", "reached" if seen and abs(seen[-1] - GOAL) < 0.02 else f"is at {seen[-1:]}", len(seen), "states")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
