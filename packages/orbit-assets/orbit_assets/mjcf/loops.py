"""Joints that close loops, from constraints of a compiled MJCF model that hold bodies together."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_assets.mjcf.model import Compiled, pose_of, vector_of
from orbit_assets.mjcf.trees import Tree
from orbit_core.scene import LoopJoint, LoopType, Pose
from orbit_core.scene.pose import Vector3

OWN_SITES = (":first", ":second")
"""Suffixes of a constraint's name in the names of sites that are only its ends."""
_TYPES = {"CONNECT": LoopType.BALL, "WELD": LoopType.WELD}
_ON_JOINTS = ("JOINT", "TENDON")


@dataclass(frozen=True)
class _End:
    """A point fixed to a body, and axes there."""

    body: int
    point: Vector3
    axes: Pose


class Loops:
    """Loops of one tree of a model.

    Raises:
        AssetError: one holds a body of another articulation, or a flex, and the options have that refused.
    """

    def __init__(self, compiled: Compiled, tree: Tree) -> None:
        self.compiled = compiled
        self.tree = tree
        self._members = set(tree.bodies)
        self._names = compiled.names_of("EQUALITY")

    def read(self) -> tuple[LoopJoint, ...]:
        """Return all loops that hold from the beginning, in the file's order."""
        found: list[LoopJoint] = []
        for index in range(self.compiled.model.neq):
            kind = self.compiled.mujoco.mjtEq(self.compiled.model.eq_type[index]).name.removeprefix("mjEQ_")
            called = f"constraint '{self._names[index] or index}'"
            if kind in _TYPES:
                loop = self._read(index, _TYPES[kind], called)
                found += [loop] if loop else []
            elif kind not in _ON_JOINTS:
                self.compiled.unsupported(f"{called} is on a flex, which is deformable", "remove it")
        return tuple(found)

    def _read(self, index: int, kind: LoopType, called: str) -> LoopJoint | None:
        model, notes = self.compiled.model, self.compiled.notes
        ends = self._ends(index, kind)
        bodies = [end.body for end in ends]
        if not any(body and body in self._members for body in bodies):
            return None
        if not model.eq_active0[index]:
            notes.append(f"{called} is inactive at first and left out")
            return None
        if any(model.body_mocapid[body] >= 0 for body in bodies):
            notes.append(f"{called} is to a body moved by motion capture, and left out with it")
            return None
        first, second = (self._rebased(end) for end in ends)
        if first is None or second is None:
            self.compiled.unsupported(f"{called} holds a body to one that is not of its articulation", "remove it")
            return None
        # Within one rigid body the constraint always holds.
        if model.body_weldid[bodies[0]] == model.body_weldid[bodies[1]]:
            notes.append(f"{called} holds a rigid body to itself, and is left out")
            return None
        # Only a weld holds the orientation.
        turned = first.axes @ second.axes.inverse() if kind is LoopType.WELD else Pose()
        name = self._names[index]
        if not name or name in self.compiled.joint_names:
            name = f"loop_{name or index}"
        one, other = (self.compiled.body_names[end.body] for end in (first, second))
        return LoopJoint(name, one, other, first.point, second.point, kind, turned.orientation)

    def _ends(self, index: int, kind: LoopType) -> tuple[_End, _End]:
        """Return the ends as two sites that coincide, or as points of two bodies, with the orientation of a weld."""
        model = self.compiled.model
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        data = model.eq_data[index]
        if model.eq_objtype[index] == int(self.compiled.mujoco.mjtObj.mjOBJ_SITE):
            return self._at_site(first), self._at_site(second)
        if kind is LoopType.BALL:
            return _End(first, vector_of(data[:3]), Pose()), _End(second, vector_of(data[3:6]), Pose())
        # eq_data of a weld: anchor on the second body, pose of the second in the first, torque scale.
        axes = pose_of((0.0, 0.0, 0.0), data[6:10])
        return _End(first, vector_of(data[3:6]), axes), _End(second, vector_of(data[:3]), Pose())

    def _at_site(self, site: int) -> _End:
        model = self.compiled.model
        axes = pose_of((0.0, 0.0, 0.0), model.site_quat[site])
        return _End(int(model.site_bodyid[site]), vector_of(model.site_pos[site]), axes)

    def _rebased(self, end: _End) -> _End | None:
        """Move an end onto a body of the tree: a point fixed in the world may be attached to a fixed root as well."""
        if end.body in self._members:
            return end
        if self.compiled.model.body_weldid[end.body] != 0 or self.tree.floating:
            return None
        between = self._in_world(self.tree.root).inverse() @ self._in_world(end.body)
        axes = Pose(orientation=between.orientation) @ end.axes
        return _End(self.tree.root, (between @ Pose(end.point)).position, axes)

    def _in_world(self, body: int) -> Pose:
        """Return the pose of a body that is fixed in the world."""
        pose = Pose()
        while body:
            pose = self.compiled.body_pose(body) @ pose
            body = int(self.compiled.model.body_parentid[body])
        return pose
