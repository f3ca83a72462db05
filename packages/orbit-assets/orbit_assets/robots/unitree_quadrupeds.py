"""Unitree A1, Go1 and Go2, quadrupeds with twelve joints."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_links, simplify_collisions
from orbit_assets.drive_design import with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, ImplicitPd, Link, Mesh, Pose, Sphere

SOURCE = "example-robot-data"
LICENCE = "MPL-2.0"
HOME = {".*_hip_joint": 0.0, ".*_thigh_joint": 0.8, ".*_calf_joint": -1.5}
# Twice the gains of legged_gym's A1 (20 and 0.5, Rudin et al. 2021), so that the knees give by some 5 degrees under the
# robot's own weight and not by 10; effort and velocity limits are the URDF's.
LEGS = ImplicitPd(joints=(".*_(hip|thigh|calf)_joint",), stiffness=40.0, damping=1.0)


_FOOT = Sphere(radius=0.022)
_FOOT_POSE = Pose((-0.002, 0.0, 0.0))


def _round_feet(articulation: Articulation) -> Articulation:
    """The robot with meshes of feet replaced by the spheres that Unitree's own description of the Go2 has there.

    The hull of 33 vertices is such a sphere within 3 mm. On terrain nine in ten of the pieces of ground that an engine
    holds a shape of the robot against are under a foot, and a sphere meets them without an iteration for its depth.
    """

    def edit(link: Link) -> Link:
        shapes = [
            replace(shape, geometry=_FOOT, pose=_FOOT_POSE) if isinstance(shape.geometry, Mesh) else shape
            for shape in link.collisions
        ]
        return replace(link, collisions=tuple(shapes))

    meshes = any(isinstance(shape.geometry, Mesh) for link in articulation.links for shape in link.collisions)
    note = "feet collide as spheres of 22 mm, as in Unitree's own description: the hulls here are those within 3 mm"
    return edit_links(articulation, (".*_foot",), note, edit) if meshes else articulation


def _part(name: str, folder: str, height: float, back: float) -> RobotPart:
    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/{folder}_description/urdf/{folder}.urdf", name)
        body = with_armature(simplify_collisions(merge_fixed_links(_round_feet(source))))
        return add_frames(body, Frame("mount", "base", Pose((0.0, 0.0, back))))

    return RobotPart(
        name=name,
        kind=PartKind.BASE,
        model=Model(name, articulation, (SOURCE,), LICENCE, parts=(with_armature,)),
        home=HOME,
        drives=(LEGS,),
        mount="mount",
        feet=("FL_foot", "FR_foot", "RL_foot", "RR_foot"),
        pose=Pose((0.0, 0.0, height)),
        fixed_base=False,
    )


A1 = _part("unitree_a1", "a1", 0.315, 0.057)
GO1 = _part("unitree_go1", "go1", 0.335, 0.057)
GO2 = _part("unitree_go2", "go2", 0.338, 0.057)
"""Their ``mount`` is on the back, above the middle of the trunk."""
