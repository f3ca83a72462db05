"""Reads an articulation from MJCF, with the format's own parser and compiler.

Everything is taken from the compiled model, in which defaults, units, nested frames and inertias are settled.

* A body with several joints becomes a chain of links, one a joint; each link in between weighs 0.1 g.
* A geom collides if its ``contype`` or ``conaffinity`` is set, and is drawn if its group is 0, 1 or 2.
* Masks say which links may collide: ``self_collisions`` and exclusions follow from them.
* Friction acts in the directions that ``condim`` opens.
* Sites become frames. Planes and height fields that do not move are terrain, and terrain is the scene's.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.assets.mjcf_files import check_references
from orbit_core.assets.mjcf_geometry import Geoms, vector_of
from orbit_core.assets.naming import names_file
from orbit_core.assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    Mimic,
    Pose,
    Shape,
)
from orbit_core.scene.pose import canonical

_LINK_MASS, _LINK_INERTIA = 1e-4, 1e-7
"""kg and kg m^2 of a link between two joints of one body: enough for an engine to invert, too little to be felt."""


@names_file
def read_mjcf(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """The one articulation in an MJCF file.

    Its root is the one body that floats freely or stands fixed in the world; where several bodies hang from the world,
    or one by a joint, the root is a link ``world`` without mass, for a fixed base.

    Raises:
        AssetError: the file does not compile, holds several articulations, a ball joint, a constraint that is no linear
            joint coupling, or MuJoCo, whose format it is, is not installed.
    """
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        raise AssetError('MJCF files need the package mujoco: pip install "orbit-core[mjcf]"') from None
    check_references(path, options)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        model = spec.compile()
    except ValueError as error:
        raise AssetError(f"{path} does not compile: {str(error).strip()}") from None
    return _Reader(model, mujoco, Path(path), spec.modelname).read()


@dataclass(eq=False)
class _Reader:
    model: Any
    mujoco: Any
    path: Path
    name: str
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._geoms = Geoms(self.model, self.mujoco, self.path, self.notes)

    def read(self) -> Articulation:
        model = self.model
        root, bodies = self._tree()
        links: list[Link] = []
        joints: list[Joint] = []
        for body in bodies:
            between, chain = self._chain(body) if body != root else ([], [])
            links += [*between, self._link(body)]
            joints += chain
        self._note_what_is_left()
        constraints = self._constraints()
        connects = [index for index in constraints if self._is_connect(index)]
        mimics = dict(self._mimic(index) for index in constraints if index not in connects)
        masks, exclusions = self._collisions(bodies)
        return Articulation(
            self.name if self.name != "MuJoCo Model" else self.path.stem,
            tuple(links),
            tuple(replace(joint, mimic=mimics.get(joint.name)) for joint in joints),
            tuple(self._frame(site) for site in range(model.nsite) if model.site_bodyid[site] in bodies),
            masks,
            tuple(exclusions),
            tuple(self.notes),
            tuple(self._loop(index) for index in connects),
        )

    def _tree(self) -> tuple[int, list[int]]:
        """The root body and all bodies of its tree, parents first."""
        model = self.model
        free = [
            body for body in range(1, model.nbody) if any(self._joint_type(j) == "FREE" for j in self._joints_of(body))
        ]
        top = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
        if mocap := [body for body in top if model.body_mocapid[body] >= 0]:
            self.notes.append(f"bodies moved by motion capture are left out: {self._names(mocap)}")
            top = [body for body in top if body not in mocap]
        if free:
            others = [body for body in top if body != free[0]]
            if any(model.body_weldid[body] != 0 for body in others) or self._moving_below(others):
                raise AssetError(f"{self.path} holds several articulations: keep one of {self._names(top)}")
            if others:
                self.notes.append(f"bodies fixed in the world are left out: {self._names(others)}")
            return free[0], self._descendants(free[0])
        if len(top) == 1 and model.body_jntnum[top[0]] == 0 and not any(True for _ in self._geoms.of_body(0)):
            return top[0], self._descendants(top[0])
        if not top and not model.body_geomnum[0]:
            raise AssetError(f"{self.path} holds no body: give it one")
        self.notes.append("link 'world', without mass, stands for what bodies hang from: fix the base")
        return 0, [0, *(body for root in top for body in self._descendants(root))]

    def _descendants(self, root: int) -> list[int]:
        found = {root}
        for body in range(root + 1, self.model.nbody):
            if int(self.model.body_parentid[body]) in found:
                found.add(body)
        return sorted(found)

    def _moving_below(self, roots: list[int]) -> bool:
        return any(self.model.body_jntnum[body] for root in roots for body in self._descendants(root))

    def _chain(self, body: int) -> tuple[list[Link], list[Joint]]:
        """The joints of a body in order, the outermost first, and the links between them."""
        model = self.model
        name, parent = self._body_name(body), self._body_name(int(model.body_parentid[body]))
        at_rest = Pose(vector_of(model.body_pos[body]), canonical(tuple(model.body_quat[body])))
        indices = self._joints_of(body)
        if not indices:
            return [], [Joint(f"{name}_fixed", JointType.FIXED, parent, name, at_rest)]
        names = [*(f"{name}_{number}" for number in range(1, len(indices))), name]
        joints: list[Joint] = []
        for index, child in zip(indices, names, strict=True):
            joints.append(self._joint(index, parent, child, at_rest))
            parent, at_rest = child, Pose()
        between = [Link(each, _LINK_MASS, inertia=_LINK_INERTIA * np.eye(3)) for each in names[:-1]]
        if between:
            self.notes.append(f"body '{name}' has {len(indices)} joints: links of {_LINK_MASS} kg stand between them")
        return between, joints

    def _joint(self, index: int, parent: str, child: str, at_rest: Pose) -> Joint:
        model = self.model
        kind = self._joint_type(index)
        name = self._joint_name(index)
        if kind not in ("HINGE", "SLIDE"):
            raise AssetError(f"joint '{name}' of {self.path} is a {kind.lower()} joint: replace it by hinges or slides")
        angular = kind == "HINGE"
        limited = bool(model.jnt_limited[index])
        lower, upper = model.jnt_range[index] if limited else (-math.inf, math.inf)
        dof = int(model.jnt_dofadr[index])
        axis = vector_of(model.jnt_axis[index])
        anchor = Pose(vector_of(model.jnt_pos[index]))
        if model.jnt_stiffness[index]:
            self.notes.append(
                f"the spring of joint '{name}' is left out: {model.jnt_stiffness[index]:g} N/m or N m/rad"
            )
        # The file places bodies where the joint is at its reference; the description, where it is at zero.
        reference = float(model.qpos0[model.jnt_qposadr[index]])
        back = Pose.from_axis_angle(axis, -reference) if angular else Pose(vector_of(-reference * np.asarray(axis)))
        kinds = (JointType.REVOLUTE if limited else JointType.CONTINUOUS) if angular else JointType.PRISMATIC
        return Joint(
            name,
            kinds,
            parent,
            child,
            at_rest @ anchor @ back,
            anchor,
            axis,
            float(lower),
            float(upper),
            self._effort_limit(index),
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
        )

    def _effort_limit(self, joint: int) -> float:
        """The least of the joint's own limit and the sum of those of the actuators that drive it alone."""
        model, trn = self.model, self.mujoco.mjtTrn
        own = _largest(model.jnt_actfrcrange[joint]) if model.jnt_actfrclimited[joint] else math.inf
        drives = [
            actuator
            for actuator in range(model.nu)
            if trn(model.actuator_trntype[actuator]) in (trn.mjTRN_JOINT, trn.mjTRN_JOINTINPARENT)
            and model.actuator_trnid[actuator, 0] == joint
        ]
        return min(own, sum(self._actuator_limit(each) for each in drives)) if drives else own

    def _actuator_limit(self, actuator: int) -> float:
        model = self.model
        gear = abs(float(model.actuator_gear[actuator, 0]))
        if model.actuator_forcelimited[actuator]:
            return gear * _largest(model.actuator_forcerange[actuator])
        bias, gain = self.mujoco.mjtBias, self.mujoco.mjtGain
        motor = bias(model.actuator_biastype[actuator]) == bias.mjBIAS_NONE
        fixed_gain = gain(model.actuator_gaintype[actuator]) == gain.mjGAIN_FIXED
        if not (motor and fixed_gain and model.actuator_ctrllimited[actuator]):
            return math.inf
        return gear * abs(float(model.actuator_gainprm[actuator, 0])) * _largest(model.actuator_ctrlrange[actuator])

    def _link(self, body: int) -> Link:
        model = self.model
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        for geom in self._geoms.of_body(body):
            shape = self._geoms.shape(geom)
            collisions += [shape] if self._collides(geom) else []
            visuals += [shape] if model.geom_group[geom] <= 2 and shape.color[3] > 0 else []
        axes = Pose(orientation=canonical(tuple(model.body_iquat[body]))).rotation_matrix()
        return Link(
            self._body_name(body),
            float(model.body_mass[body]),
            vector_of(model.body_ipos[body]),
            axes @ np.diag(model.body_inertia[body]) @ axes.T,
            tuple(collisions),
            tuple(visuals),
        )

    def _frame(self, site: int) -> Frame:
        model = self.model
        body = self._body_name(int(model.site_bodyid[site]))
        name = model.site(site).name or f"site_{site}"
        if name in {self._body_name(each) for each in range(model.nbody)}:
            name = f"{name}_site"
        return Frame(name, body, Pose(vector_of(model.site_pos[site]), canonical(tuple(model.site_quat[site]))))

    def _constraints(self) -> list[int]:
        """Indices of the equality constraints that hold from the beginning."""
        active = []
        for index in range(self.model.neq):
            if self.model.eq_active0[index]:
                active.append(index)
            else:
                self.notes.append(f"constraint '{self._constraint_name(index)}' is inactive at first and left out")
        return active

    def _constraint_name(self, index: int) -> str:
        return self.model.equality(index).name or str(index)

    def _is_connect(self, index: int) -> bool:
        return self.mujoco.mjtEq(self.model.eq_type[index]) == self.mujoco.mjtEq.mjEQ_CONNECT

    def _mimic(self, index: int) -> tuple[str, Mimic]:
        """The follower's name, and how it follows."""
        model, kinds = self.model, self.mujoco.mjtEq
        follower, leader = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        coefficients = model.eq_data[index, :5]
        linear = kinds(model.eq_type[index]) == kinds.mjEQ_JOINT and leader >= 0
        if not linear or np.any(coefficients[2:] != 0):
            name = self._constraint_name(index)
            raise AssetError(f"constraint '{name}' of {self.path} is no linear coupling of two joints: remove it")
        offset, slope = float(coefficients[0]), float(coefficients[1])
        rest, leader_rest = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (follower, leader))
        mimic = Mimic(self._joint_name(leader), slope, rest + offset - slope * leader_rest)
        return self._joint_name(follower), mimic

    def _loop(self, index: int) -> LoopJoint:
        """Of a ``connect`` constraint, given by an anchor on two bodies or by two sites."""
        model = self.model
        ends = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        points = model.eq_data[index, :3], model.eq_data[index, 3:6]
        if model.eq_objtype[index] == self.mujoco.mjtObj.mjOBJ_SITE:
            points = model.site_pos[ends[0]], model.site_pos[ends[1]]
            ends = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
        first, second = (self._body_name(body) for body in ends)
        return LoopJoint(f"loop_{self._constraint_name(index)}", first, second, *map(vector_of, points))

    def _collisions(self, bodies: list[int]) -> tuple[bool, list[tuple[str, str]]]:
        """Whether any two links may collide, and the pairs that never do although others may."""
        model = self.model
        colliders = {body: [geom for geom in self._geoms.of_body(body) if self._collides(geom)] for body in bodies}
        solid = [body for body in bodies if colliders[body]]
        # An exclusion's signature is the two bodies' numbers, 16 bits each.
        excluded = {(int(mark) >> 16, int(mark) & 0xFFFF) for mark in model.exclude_signature}
        apart: list[tuple[str, str]] = []
        may = False
        for first, second in combinations(solid, 2):
            if model.body_parentid[second] == first and model.body_jntnum[second] <= 1:
                continue
            masked = not any(self._masks_meet(a, b) for a in colliders[first] for b in colliders[second])
            if masked or self._joined(first, second) or {(first, second), (second, first)} & excluded:
                apart.append((self._body_name(first), self._body_name(second)))
            else:
                may = True
        return may, apart if may else []

    def _joined(self, first: int, second: int) -> bool:
        """Whether two bodies are one, or parent and child, once those without a joint count with their parents."""
        weld, parent = self.model.body_weldid, self.model.body_parentid
        one, other = int(weld[first]), int(weld[second])
        return one == other or (one != 0 and one == weld[parent[other]]) or (other != 0 and other == weld[parent[one]])

    def _collides(self, geom: int) -> bool:
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def _masks_meet(self, first: int, second: int) -> bool:
        types, affinities = self.model.geom_contype, self.model.geom_conaffinity
        return bool(types[first] & affinities[second] or types[second] & affinities[first])

    def _note_what_is_left(self) -> None:
        model, kinds = self.model, self.mujoco.mjtGeom
        terrain = np.isin(model.geom_type, (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD))
        if moving := [geom for geom in np.flatnonzero(terrain) if model.body_weldid[model.geom_bodyid[geom]] != 0]:
            raise AssetError(f"geom {moving[0]} of {self.path} is a plane or height field that moves: make it a box")
        counts = {
            "planes and height fields": int(terrain.sum()),
            "actuators, but for their effort limits,": model.nu,
            "tendons": model.ntendon,
            "contact pairs": model.npair,
            "flexes": model.nflex,
        }
        self.notes += [f"{what} are left out: {count}" for what, count in counts.items() if count]

    def _joints_of(self, body: int) -> list[int]:
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def _joint_type(self, joint: int) -> str:
        return self.mujoco.mjtJoint(self.model.jnt_type[joint]).name.removeprefix("mjJNT_")

    def _joint_name(self, joint: int) -> str:
        return self.model.joint(joint).name or f"{self._body_name(int(self.model.jnt_bodyid[joint]))}_joint_{joint}"

    def _body_name(self, body: int) -> str:
        return self.model.body(body).name or f"body_{body}"

    def _names(self, bodies: list[int]) -> str:
        return ", ".join(self._body_name(body) for body in bodies)


def _largest(limits: Any) -> float:
    return float(np.abs(limits).max())
