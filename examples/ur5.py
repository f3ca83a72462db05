"""A new robot: one function that builds it, one entry in the catalogue."""

from __future__ import annotations

import math

from orbit_assets.cache import Model, cached_articulation
from orbit_assets.catalogue import RobotEntry, robots
from orbit_assets.sources import model_folder
from orbit_assets.urdf import read_urdf
from orbit_core.envs import make
from orbit_core.scene import Articulation, EndEffector, ImplicitPd, RobotSpec

SOURCE = "example-robot-data"
HOME = {  # the flange points down
    "shoulder_lift_joint": -1.2,
    "elbow_joint": 1.9,
    "wrist_1_joint": -2.3,
    "wrist_[23]_joint": -math.pi / 2,
}


def build() -> RobotSpec:
    """The arm without a gripper. The URDF's ``tool0`` has z out of the flange."""
    return RobotSpec(
        name="my_ur5",
        articulation=cached_articulation(Model("my_ur5", articulation, (SOURCE,), "BSD")),
        fixed_base=True,
        home=HOME,
        actuators=(ImplicitPd(joints=(".*",), stiffness=800.0, damping=80.0),),
        gravity_compensation=True,
        end_effectors=(EndEffector("tool0", (".*",)),),
        semantic_label="robot",
        licence="BSD",
        source=SOURCE,
    )


def articulation() -> Articulation:
    """Read from the package's files once; from the cache afterwards."""
    folder = model_folder(SOURCE)
    return read_urdf(folder / "robots/ur_description/urdf/ur5_robot.urdf", {SOURCE: folder}, "my_ur5")


def main() -> None:
    """Reach with the new arm."""
    robots().add(RobotEntry("my_ur5", "Universal Robots UR5: 6-joint arm", build, SOURCE, "BSD"))
    environment = make("Reach", num_envs=16, backend="mujoco", seed=0, robot="my_ur5")
    expert = environment.expert()
    info = {}
    for _ in range(environment.max_episode_steps):
        *_, info = environment.step(expert.compute({})["action"])
    end = info["final"]
    print(
        f"{int(end.success.sum())} of {len(end.success)} reached, off by {end.metrics['position_error_m'].mean():.4f} m"
    )
    environment.close()


if __name__ == "__main__":
    main()
