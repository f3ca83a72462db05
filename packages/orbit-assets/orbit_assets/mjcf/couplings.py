"""Constraints and fixed tendons of a compiled MJCF model on its joints: mimics, fixed joints, springs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from orbit_assets.mjcf.model import Compiled, pose_of, vector_of
from orbit_assets.mjcf.trees import Tree
from orbit_core.scene import Joint, JointType, LoopJoint, LoopType, Mimic, Pose
from orbit_core.scene.pose import Vector3

# Joints that close loops, from constraints of a compiled MJCF model that hold bodies together -------------------------

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
        """Compiled model."""
        self.tree = tree
        """Tree whose loops they are."""
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


# Share of the largest coefficient of a law below which a coefficient counts as none.
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class Law:
    """The position of joint ``follower``: a polynomial in that of ``leader``, or a constant where there is none."""

    follower: int
    leader: int | None
    coefficients: tuple[float, ...]
    """Coefficients of the leader's powers, from the zeroth on."""

    def mimic(self, leader_name: str) -> Mimic:
        """Return the law as the description's mimic."""
        offset, multiplier, *higher = (*self.coefficients, 0.0)[: max(2, len(self.coefficients))]
        return Mimic(leader_name, multiplier, offset, tuple(higher))

    def turned(self) -> Law | None:
        """Return the same law solved for the other joint, or None if it has no unique solution."""
        if self.leader is None or len(self.coefficients) != 2 or not self.coefficients[1]:
            return None
        offset, slope = self.coefficients
        return Law(self.leader, self.follower, (-offset / slope, 1.0 / slope))


def polynomial_law(
    follower: tuple[int, float], leader: tuple[int, float] | None, coefficients: np.ndarray, scales: tuple[float, float]
) -> Law:
    """Return the law of ``scale * (q - reference)`` of the follower, a polynomial in the same of the leader.

    Args:
        follower: a joint's number, and its reference.
        leader: likewise, or ``None`` for a constant.
        coefficients: (5,) of the polynomial, from the zeroth power on.
        scales: of the follower and of the leader.
    """
    joint, rest = follower
    own, others = scales
    if leader is None:
        return Law(joint, None, (rest + float(coefficients[0]) / own,))
    other, other_rest = leader
    # Composition of polynomials: the leader's reference and scale go into its coefficients.
    powers = np.polynomial.Polynomial(coefficients / own)(
        np.polynomial.Polynomial((-others * other_rest, others))
    ).coef.tolist()
    powers += [0.0] * (2 - len(powers))
    powers[0] += rest
    # Trailing zeros are dropped so that a linear law is recognised as one.
    while len(powers) > 2 and powers[-1] == 0.0:
        powers.pop()
    return Law(joint, other, tuple(float(power) for power in powers))


def linear_law(coefficients: Mapping[int, float], total: float) -> Law | None:
    """Return the law of a weighted sum of joint positions of given value; None unless it is of one joint or two."""
    largest = max((abs(value) for value in coefficients.values()), default=0.0)
    held = {joint: value for joint, value in coefficients.items() if abs(value) > _NEGLIGIBLE * largest}
    if len(held) == 1:
        ((joint, coefficient),) = held.items()
        return Law(joint, None, (total / coefficient,))
    if len(held) == 2:
        leader, follower = sorted(held)
        return Law(follower, leader, (total / held[follower], -held[leader] / held[follower]))
    return None


@dataclass(frozen=True)
class Share:
    """Contribution of a tendon to its joint, in the joint's own units; see :class:`orbit_core.scene.Joint`."""

    lower_limit: float
    """rad or m."""
    upper_limit: float
    """rad or m."""
    stiffness: float
    """N m/rad or N/m."""
    rest_position: float
    """rad or m."""
    damping: float
    """N m s/rad or N s/m."""
    friction: float
    """N m or N."""
    armature: float
    """kg m^2 or kg."""

    def added(self, joint: Joint) -> Joint:
        """Return the joint with this share: the narrower limits, and one spring that pulls as both do."""
        lower, upper = max(joint.lower_limit, self.lower_limit), min(joint.upper_limit, self.upper_limit)
        limited = (lower, upper) != (-math.inf, math.inf)
        stiffness = joint.stiffness + self.stiffness
        # Two springs in parallel pull like one at the mean of their rest positions, weighted by stiffness.
        pull = joint.stiffness * joint.rest_position + self.stiffness * self.rest_position
        return replace(
            joint,
            type=JointType.REVOLUTE if limited and joint.type is JointType.CONTINUOUS else joint.type,
            lower_limit=lower,
            upper_limit=max(lower, upper),
            stiffness=stiffness,
            rest_position=pull / stiffness if stiffness else 0.0,
            damping=joint.damping + self.damping,
            friction=joint.friction + self.friction,
            armature=joint.armature + self.armature,
        )


def share_of(compiled: Compiled, tendon: int, coefficient: float) -> Share | None:
    """Compute the share of a tendon of length ``coefficient * position``; None if no joint can have it.

    The tendon's force acts on the joint times the coefficient (MuJoCo's documentation, "Computation", on actuation and
    tendons), so that its stiffness, damping and armature count with the coefficient's square.
    """
    model = compiled.model
    slack = model.tendon_lengthspring[tendon].tolist()
    stiffness = float(model.tendon_stiffness[tendon])
    curved = np.any(model.tendon_stiffnesspoly[tendon]) or np.any(model.tendon_dampingpoly[tendon])
    # A dead zone between two slack lengths, or a polynomial spring, is no spring that a joint has.
    if not coefficient or curved or (stiffness and slack[0] != slack[1]):
        return None
    ends = (-math.inf, math.inf)
    if model.tendon_limited[tendon]:
        # A negative coefficient exchanges the ends.
        first, second = (float(length) / coefficient for length in model.tendon_range[tendon])
        ends = min(first, second), max(first, second)
    return Share(
        *ends,
        stiffness * coefficient**2,
        slack[0] / coefficient if stiffness else 0.0,
        float(model.tendon_damping[tendon]) * coefficient**2,
        float(model.tendon_frictionloss[tendon]) * abs(coefficient),
        float(model.tendon_armature[tendon]) * coefficient**2,
    )


@dataclass(eq=False)
class Couplings:
    """Couplings of one tree of a model, read from its constraints on joints and tendons and from its tendons."""

    compiled: Compiled
    """Compiled model."""
    tree: Tree
    """Tree whose couplings they are."""
    laws: dict[int, Law] = field(default_factory=dict)
    """Laws by their followers' numbers."""
    shares: dict[int, list[Share]] = field(default_factory=dict)
    """Contributions of tendons over one joint, by the joint's number."""

    def __post_init__(self) -> None:
        self._members = set(self.tree.bodies)
        self._names = self.compiled.names_of("EQUALITY")
        self._tendon_names = self.compiled.names_of("TENDON")
        for index in range(self.compiled.model.neq):
            self._read(index)
        self._meet_tendons()
        self._settle()

    def applied(self, joint: Joint, number: int) -> Joint:
        """Apply the constraints of a joint of the file: it follows another, or is fixed where it is held."""
        for share in self.shares.get(number, ()):
            joint = share.added(joint)
        law = self.laws.get(number)
        if law is None:
            return joint
        if law.leader is not None:
            return replace(joint, mimic=law.mimic(self.compiled.joint_names[law.leader]))
        at = law.coefficients[0]
        along = vector_of(at * np.asarray(joint.axis))
        moved = Pose(along) if joint.type is JointType.PRISMATIC else Pose.from_axis_angle(joint.axis, at)
        held = joint.parent_pose @ moved
        return Joint(joint.name, JointType.FIXED, joint.parent, joint.child, held, joint.child_pose)

    def _read(self, index: int) -> None:
        model = self.compiled.model
        kind = self.compiled.mujoco.mjtEq(model.eq_type[index]).name.removeprefix("mjEQ_")
        if kind not in ("JOINT", "TENDON"):
            return
        called = f"constraint '{self._names[index] or index}'"
        if not model.eq_active0[index]:
            self.compiled.notes.append(f"{called} is inactive at first and left out")
        elif kind == "JOINT":
            self._read_joints(index, called)
        else:
            self._read_tendons(index, called)

    def _read_joints(self, index: int, called: str) -> None:
        model = self.compiled.model
        follower, leader = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if not self._here([joint for joint in (follower, leader) if joint >= 0], called):
            return
        other = (leader, self._reference(leader)) if leader >= 0 else None
        self._add(
            polynomial_law((follower, self._reference(follower)), other, model.eq_data[index, :5], (1.0, 1.0)), called
        )

    def _read_tendons(self, index: int, called: str) -> None:
        """Read a constraint of two fixed tendons whose lengths follow a law, or of one whose length is held."""
        model = self.compiled.model
        tendons = [int(tendon) for tendon in (model.eq_obj1id[index], model.eq_obj2id[index]) if tendon >= 0]
        parts = [self.fixed_tendon(tendon) for tendon in tendons]
        coefficients = np.asarray(model.eq_data[index, :5])
        if any(part is None for part in parts):
            self.compiled.unsupported(f"{called} is on a tendon that runs through space", "couple its joints instead")
            return
        joints = [joint for part in parts if part for joint in part]
        if not self._here(joints, called):
            return
        own, other = parts[0] or {}, (parts[1] or {}) if len(parts) > 1 else {}
        if len(own) == 1 and len(other) == 1 and own.keys() != other.keys():
            ((follower, scale),), ((leader, others),) = own.items(), other.items()
            ends = (follower, self._reference(follower)), (leader, self._reference(leader))
            law: Law | None = polynomial_law(*ends, coefficients, (scale, others))
        # A nonlinear law of several joints has no form that a mimic could hold.
        elif np.any(coefficients[2:]):
            law = None
        else:
            slope = float(coefficients[1]) if other else 0.0
            sums = {joint: own.get(joint, 0.0) - slope * other.get(joint, 0.0) for joint in {*own, *other}}
            rest = sum(value * self._reference(joint) for joint, value in sums.items())
            law = linear_law(sums, rest + float(coefficients[0]))
        if law is None:
            self.compiled.unsupported(f"{called} couples more than two joints by tendons", "couple joints in pairs")
        else:
            self._add(law, called)

    def _add(self, law: Law, called: str) -> None:
        """Keep a law; one whose follower already has a law is solved for its leader."""
        chosen = law
        if law.follower in self.laws:
            turned = law.turned()
            if turned is None or turned.follower in self.laws:
                name = self.compiled.joint_names[law.follower]
                self.compiled.unsupported(
                    f"{called} couples joint '{name}', which another constraint couples", "keep one"
                )
                return
            chosen = turned
        self.laws[chosen.follower] = chosen

    def _settle(self) -> None:
        """Make followers of followers follow the first leader, or stand where it does; circles stay for validation to
        name.
        """
        for number in list(self.laws):
            law, seen = self.laws[number], {number}
            while law.leader in self.laws and law.leader not in seen:
                seen.add(law.leader)
                above = self.laws[law.leader]
                powers = np.polynomial.Polynomial(law.coefficients)(np.polynomial.Polynomial(above.coefficients))
                law = Law(number, above.leader, tuple(np.atleast_1d(powers.coef).tolist()))
            self.laws[number] = law

    def fixed_tendon(self, tendon: int) -> dict[int, float] | None:
        """Return the joints and weights of a tendon whose length is a weighted sum of positions; None for other
        tendons.
        """
        model = self.compiled.model
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        joint_kind = int(self.compiled.mujoco.mjtWrap.mjWRAP_JOINT)
        found: dict[int, float] = {}
        for wrap in range(first, first + count):
            if model.wrap_type[wrap] != joint_kind:
                return None
            joint = int(model.wrap_objid[wrap])
            found[joint] = found.get(joint, 0.0) + float(model.wrap_prm[wrap])
        return found

    def _meet_tendons(self) -> None:
        """Add or reject tendons that pull or hold by themselves; couple two joints that one motor moves through a
        tendon.
        """
        model = self.compiled.model
        driven = {
            int(model.actuator_trnid[actuator, 0])
            for actuator in range(model.nu)
            if model.actuator_trntype[actuator] == int(self.compiled.mujoco.mjtTrn.mjTRN_TENDON)
        }
        for tendon in range(model.ntendon):
            weights = self.fixed_tendon(tendon)
            if weights is not None and not any(self._body(joint) in self._members for joint in weights):
                continue
            called = f"tendon '{self._tendon_names[tendon] or tendon}'"
            if weights is not None and len(weights) == 1:
                ((joint, coefficient),) = weights.items()
                share = share_of(self.compiled, tendon, coefficient)
                if share is not None:
                    self.shares.setdefault(joint, []).append(share)
                    continue
            if acts := self._acts(tendon):
                self.compiled.unsupported(f"{called} has {' and '.join(acts)}", "remove it or move it to the joints")
            if tendon in driven and weights is not None and len(weights) == 2:
                self._couple(weights, called)

    def _couple(self, weights: dict[int, float], called: str) -> None:
        """Make two joints that one motor drives through a tendon move in proportion, as it pulls on them."""
        leader, follower = sorted(weights)
        if {leader, follower} & self.laws.keys() or not self._here([leader, follower], called):
            return
        slope = weights[follower] / weights[leader]
        offset = self._reference(follower) - slope * self._reference(leader)
        self.laws[follower] = Law(follower, leader, (offset, slope))
        one, other = (self.compiled.joint_names[joint] for joint in (leader, follower))
        self.compiled.notes.append(
            f"{called}, by which one motor pulls on joints '{one}' and '{other}', couples them: '{other}' follows "
            f"'{one}' at {slope:.4g}, where the file lets what they touch move them apart"
        )

    def _acts(self, tendon: int) -> list[str]:
        model = self.compiled.model
        properties = (
            ("a limit", model.tendon_limited),
            ("a spring", model.tendon_stiffness),
            ("a spring that is not linear", model.tendon_stiffnesspoly),
            ("damping", model.tendon_damping),
            ("damping that is not linear", model.tendon_dampingpoly),
            ("friction", model.tendon_frictionloss),
            ("armature", model.tendon_armature),
        )
        return [word for word, values in properties if np.any(values[tendon])]

    def _here(self, joints: list[int], called: str) -> bool:
        """Return True if all joints of a constraint are in this tree; reject one that couples two articulations."""
        inside = [self._body(joint) in self._members for joint in joints]
        if any(inside) and not all(inside):
            self.compiled.unsupported(f"{called} couples joints of two articulations", "remove it")
        return all(inside)

    def _body(self, joint: int) -> int:
        return int(self.compiled.model.jnt_bodyid[joint])

    def _reference(self, joint: int) -> float:
        return float(self.compiled.model.qpos0[self.compiled.model.jnt_qposadr[joint]])
