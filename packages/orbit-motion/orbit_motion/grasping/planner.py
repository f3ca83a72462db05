"""Motion to a grasp: in front of the thing, straight to it, and straight up with it.

:class:`GraspSearch` computes the timed motion of each candidate in a copy of the world.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links, shapes_in_frame
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    pose_inverse,
    pose_multiply,
    quat_from_matrix,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_matrix,
    transform_points,
)
from orbit_core.interfaces import ArgumentError, ConfigurationError, PlanningError
from orbit_core.interfaces.layout import joint_limits
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Gripper, HeightField, Link, Plane, RobotSpec
from orbit_motion.compliant import PlacedRobot, PlacedWorld
from orbit_motion.full_ik import FullIk, FullIkConfig
from orbit_motion.obstacles import TERRAIN
from orbit_motion.planning import JointPlanner, JointTrajectory, PlannerConfig, StillWorld, time_optimal

# Antipodal grasps: two points of a surface whose line is in both friction cones, ranked by how well they would hold.
# Two fingers with friction hold a thing in all directions where the line between them is within both friction cones:
# Nguyen, Constructing Force-Closure Grasps (International Journal of Robotics Research 7(3), 1988). Candidates are
# drawn and the patch between the fingers judged as ten Pas et al. do, Grasp Pose Detection in Point Clouds
# (International Journal of Robotics Research 36(13), 2017). Surfaces are points with normals, of collision shapes or of
# a depth camera's cloud; the gripper is a set of boxes around its links, wide open.

# Metres along the approach from the frame within which fingers limit the opening.
_NEAR = 0.01


@dataclass(frozen=True, eq=False)
class HandBoxes:
    """Boxes (B, 2, 3), least and largest corner in m, and the opening (m) between fingers along the frame's y."""

    boxes: Tensor
    """(B, 2, 3) m, in the frame of the hand."""
    opening: float
    """m between the open fingers."""
    points: Tensor
    """Points (P, 3) in m on the shapes themselves."""

    @staticmethod
    def of(spec: RobotSpec) -> HandBoxes:
        """Compute the boxes of a robot's first end effector, with its gripper open.

        Raises:
            ConfigurationError: it has no gripper, or nothing of it is on both sides of its frame.
        """
        effector = spec.end_effectors[0] if spec.end_effectors else None
        if effector is None or effector.gripper is None:
            raise ConfigurationError(f"robot '{spec.name}' has no gripper to grasp with")
        posture = gripper_posture(spec, effector.gripper, effector.gripper.open_position)
        clouds = shapes_in_frame(spec, effector.frame, _hand_links(spec, effector.gripper), posture)
        boxes = [torch.tensor(np.stack((cloud.min(0), cloud.max(0))), dtype=torch.float32) for cloud in clouds]
        stacked = torch.stack(boxes) if boxes else torch.zeros(0, 2, 3)
        points = torch.tensor(np.concatenate(clouds or [np.zeros((0, 3))]), dtype=torch.float32)
        return HandBoxes(stacked, _opening(stacked, spec.name), points)

    def touches(self, points: Tensor, margin: float = 0.0) -> Tensor:
        """Return True (...,) if any of the points (..., M, 3) in the end effector's frame is within ``margin`` m of a
        box.
        """
        low, high = self.boxes[:, 0] - margin, self.boxes[:, 1] + margin
        inside = (points[..., None, :] > low.to(points)) & (points[..., None, :] < high.to(points))
        return inside.all(-1).any(-1).any(-1)


def _hand_links(spec: RobotSpec, gripper: Gripper) -> list[Link]:
    """Return the links that the gripper moves, and the links that carry them."""
    moving = {link.name for link in gripping_links(spec, gripper)}
    carriers = {joint.parent for joint in spec.articulation.joints if joint.child in moving}
    return [link for link in spec.articulation.links if link.name in moving | carriers]


def _opening(boxes: Tensor, name: str) -> float:
    near = (boxes[:, 0, 2] < _NEAR) & (boxes[:, 1, 2] > -_NEAR)
    left, right = near & (boxes[:, 0, 1] > 0.0), near & (boxes[:, 1, 1] < 0.0)
    if not left.any() or not right.any():
        raise ConfigurationError(f"the gripper of '{name}' has no finger on each side of its frame: it is not parallel")
    return float(boxes[left, 0, 1].min() - boxes[right, 1, 1].max())


# Neighbours of a point in a cloud from which its normal is estimated.
_NEIGHBOURS = 16


@dataclass(frozen=True, eq=False)
class Surface:
    """Points (M, 3) in metres and unit normals (M, 3) pointing outwards, in one frame."""

    points: Tensor
    """(M, 3) m."""
    normals: Tensor
    """(M, 3), outwards."""

    def __post_init__(self) -> None:
        if self.points.shape != self.normals.shape or self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ArgumentError(
                f"a surface has points {tuple(self.points.shape)} and normals {tuple(self.normals.shape)}: "
                "give (M, 3) each"
            )


def surface_of(link: Link, count: int = 2000, seed: int = 0) -> Surface:
    """Sample ``count`` points evenly from a link's collision shapes, in the link's frame.

    Raises:
        ArgumentError: the link has no collision shape of finite size.
    """
    import trimesh

    shapes = [shape for shape in link.collisions if not isinstance(shape.geometry, Plane | HeightField)]
    if not shapes:
        raise ArgumentError(f"link '{link.name}' has no collision shapes of finite size: there is nothing to grasp")
    meshes = []
    for shape in shapes:
        mesh = triangles(shape.geometry)
        mesh.apply_transform(shape.pose.matrix())
        meshes.append(mesh)
    joined: Any = trimesh.util.concatenate(meshes)
    points, faces, *_ = trimesh.sample.sample_surface(joined, count, seed=seed)
    return Surface(
        torch.as_tensor(np.asarray(points), dtype=torch.float32),
        torch.as_tensor(np.asarray(joined.face_normals[faces]), dtype=torch.float32),
    )


def surface_of_cloud(points: Tensor, eye: Tensor) -> Surface:
    """Estimate normals of points (M, 3) that a camera at ``eye`` (3,) saw; they point towards it.

    A normal is the direction in which a point's 16 nearest vary least: Hoppe et al., Surface Reconstruction from
    Unorganized Points (SIGGRAPH 1992).

    Raises:
        ArgumentError: there are fewer points than a neighbourhood has.
    """
    if len(points) < _NEIGHBOURS:
        raise ArgumentError(f"a cloud of {len(points)} points has no normals: give {_NEIGHBOURS} or more")
    nearest = torch.cdist(points, points).topk(_NEIGHBOURS, largest=False).indices
    around = points[nearest]
    spread = around - around.mean(1, keepdim=True)
    # Eigenvalues ascend: the first eigenvector is the direction of least variation.
    _, axes = torch.linalg.eigh(spread.transpose(1, 2) @ spread)
    normals = axes[:, :, 0]
    away = ((points - eye) * normals).sum(1, keepdim=True) > 0.0
    return Surface(points, torch.where(away, -normals, normals))


# Least distance (m) between an open finger and the thing.
_CLEARANCE = 0.002
# Metres around the line between the fingers within which the surface is judged.
_PATCH = 0.01
# Points of the surface that are tested against the hand.
_CHECKED = 400
# Least distance (m) between the two points of a grasp.
_SPARSE = 1e-3


@dataclass(frozen=True, kw_only=True)
class GraspConfig:
    """Sampling of candidates.

    Raises:
        ArgumentError: a number is out of its range.
    """

    friction: float = 0.5
    """Coefficient between fingers and thing."""
    samples: int = 400
    """Points from which a line to the other side is drawn."""
    directions: int = 12
    """Directions of approach, evenly around each line."""
    most: int = 64
    """Most candidates that are returned, the best ones."""
    seed: int = 0
    """Seed of the sampling: equal seeds give equal candidates."""

    def __post_init__(self) -> None:
        for name in ("friction", "samples", "directions", "most"):
            if not getattr(self, name) > 0:
                raise ArgumentError(f"setting '{name}' of grasp candidates is {getattr(self, name)}: give more than 0")


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """K grasps, the best first, in the frame of the surface."""

    poses: Tensor
    """Poses (K, 7) of the end effector: z along the approach, y from one finger to the other."""
    widths: Tensor
    """Distances (K,) in m between the two points."""
    contacts: Tensor
    """Contact points (K, 2, 3) in m."""
    scores: Tensor
    """Scores (K,) from 0 to 1."""

    def __len__(self) -> int:
        return len(self.scores)


def grasp_candidates(
    surface: Surface, hand: HandBoxes, config: GraspConfig = GraspConfig(), up: Tensor | None = None
) -> GraspCandidates:
    """Find grasps of a surface by a hand, ranked by the mean of four scores.

    They are: how far inside the friction cones the line is; how near the line goes to the thing's middle, so that it
    hardly turns in the hand; which part of the surface between the fingers faces them; and how far the approach is from
    above, where ``up`` (3,) is given in the surface's frame.

    Raises:
        ArgumentError: none is possible: the thing is too wide for the hand, or no two sides face each other.
    """
    pairs = _pairs(surface, hand.opening, config)
    if not len(pairs):
        raise ArgumentError(
            f"no grasp of {hand.opening:.3f} m at most with a friction coefficient of {config.friction:g}: no two "
            "sides of the thing face each other so near"
        )
    poses, contacts = _around(surface.points[pairs], config.directions)
    stride = max(1, len(surface.points) // _CHECKED)
    checked = Surface(surface.points[::stride], surface.normals[::stride])
    local = quat_rotate_inverse(poses[:, None, 3:], checked.points - poses[:, None, :3])
    free = ~hand.touches(local, _CLEARANCE)
    if not free.any():
        raise ArgumentError("every grasp would have the open hand inside the thing: its fingers do not reach around it")
    poses, contacts, local = poses[free], contacts[free], local[free]
    normals = surface.normals[pairs].repeat_interleave(config.directions, 0)[free]
    scores = [_cone(contacts, normals, config.friction), _central(contacts, surface), _facing(local, poses, checked)]
    if up is not None:
        approach = _axes(poses)[:, :, 2]
        scores.append(0.5 - 0.5 * (approach @ normalize(up, dim=0)))
    # Unweighted: none of the scores is a probability, and none has shown to matter more.
    score = torch.stack(scores).mean(0)
    best = score.argsort(descending=True, stable=True)[: config.most]
    width = torch.linalg.vector_norm(contacts[:, 1] - contacts[:, 0], dim=1)
    return GraspCandidates(poses[best], width[best], contacts[best], score[best])


def _pairs(surface: Surface, opening: float, config: GraspConfig) -> Tensor:
    """Return index pairs (K, 2) of points that face each other within the opening and the cones."""
    points, normals = surface.points, surface.normals
    generator = torch.Generator().manual_seed(config.seed)
    first = torch.randint(len(points), (config.samples,), generator=generator).to(points.device)
    angle = math.atan(config.friction)
    noise = torch.randn(config.samples, 3, generator=generator).to(points)
    # A line within the friction cone: tilted from the normal by less than its angle.
    lean = torch.rand(config.samples, 1, generator=generator).to(points) * math.tan(angle)
    across = normalize(noise - (noise * normals[first]).sum(1, keepdim=True) * normals[first], dim=1)
    line = normalize(across * lean - normals[first], dim=1)
    arms = points - points[first][:, None]
    along = (arms * line[:, None]).sum(-1)
    aside = torch.linalg.vector_norm(arms - along[..., None] * line[:, None], dim=-1)
    # The spacing of points: half of them have the nearest other closer than that.
    spacing = torch.cdist(points[first], points).topk(2, largest=False).values[:, 1].median()
    last = torch.where(aside < 2.0 * spacing, along, -torch.inf).argmax(1)
    pairs = torch.stack((first, last), dim=1)
    axis = points[last] - points[first]
    width = torch.linalg.vector_norm(axis, dim=1)
    axis = axis / width[:, None].clamp_min(_SPARSE)
    least = math.cos(angle)
    closed = ((-normals[first] * axis).sum(1) >= least) & ((normals[last] * axis).sum(1) >= least)
    return pairs[closed & (width > _SPARSE) & (width < opening - 2.0 * _CLEARANCE)]


def _around(ends: Tensor, directions: int) -> tuple[Tensor, Tensor]:
    """Return poses (K D, 7) between points (K, 2, 3), and those points for each."""
    y = normalize(ends[:, 1] - ends[:, 0], dim=1)
    least = torch.nn.functional.one_hot(y.abs().argmin(1), 3).to(y)
    # The axis that is least parallel to the line gives a well-conditioned side.
    side = normalize(torch.linalg.cross(y, least), dim=1)
    other = torch.linalg.cross(y, side)
    turns = torch.arange(directions, device=y.device) * (2.0 * math.pi / directions)
    z = side[:, None] * turns.cos()[:, None] + other[:, None] * turns.sin()[:, None]
    y = y[:, None].expand_as(z)
    axes = torch.stack((torch.linalg.cross(y, z), y, z), dim=-1)
    middle = ends.mean(1)[:, None].expand_as(z)
    poses = torch.cat((middle, quat_from_matrix(axes)), dim=-1).flatten(0, 1)
    return poses, ends.repeat_interleave(directions, 0)


def _axes(poses: Tensor) -> Tensor:
    return quat_to_matrix(poses[:, 3:])


def _cone(contacts: Tensor, normals: Tensor, friction: float) -> Tensor:
    """Score (K,): 1 where the line is along both normals, 0 at the edge of a cone."""
    axis = normalize(contacts[:, 1] - contacts[:, 0], dim=1)
    cosine = torch.minimum(-(normals[:, 0] * axis).sum(1), (normals[:, 1] * axis).sum(1))
    return 1.0 - torch.arccos(cosine.clamp(-1.0, 1.0)) / math.atan(friction)


def _central(contacts: Tensor, surface: Surface) -> Tensor:
    """Score (K,): 1 where the line passes through the middle of the points, 0 at their farthest from it."""
    middle = surface.points.mean(0)
    size = torch.linalg.vector_norm(surface.points - middle, dim=1).max()
    axis = normalize(contacts[:, 1] - contacts[:, 0], dim=1)
    arm = middle - contacts[:, 0]
    off = torch.linalg.vector_norm(arm - (arm * axis).sum(1, keepdim=True) * axis, dim=1)
    return 1.0 - (off / size).clamp(0.0, 1.0)


def _facing(local: Tensor, poses: Tensor, surface: Surface) -> Tensor:
    """Score (K,): mean component of the normals along the line, over the surface that the pads would touch."""
    between = (local[..., 0].abs() < _PATCH) & (local[..., 2].abs() < _PATCH)
    along = (surface.normals @ _axes(poses)[:, :, 1].transpose(0, 1)).transpose(0, 1).abs()
    return (along * between).sum(1) / between.sum(1).clamp_min(1)


# Postures along a straight part of the motion.
_STRAIGHT = 8
# Candidates per batch of inverse kinematics: few, so that the first plan does not wait for all.
_AT_ONCE = 8
# rad or m between postures of a straight part beyond which the arm has changed its branch of solutions.
_JUMP = 0.5


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """Motion for one candidate; between two rows joints move in straight lines."""

    candidate: int | None
    """Index among the candidates; None for a given pose."""
    reach: Tensor
    """Joint positions (P, k) to the pre-grasp pose, around obstacles."""
    approach: Tensor
    """Joint positions (Q, k) along the hand's z axis to the thing; then the gripper closes."""
    lift: Tensor
    """Joint positions (R, k) straight up with it."""


class GraspPlanner:
    """Planner of grasps for a robot's first end effector in one environment at a time.

    Args:
        world: of the robot; a :class:`~orbit_motion.planning.StillWorld` for plans in another thread.
        robot: that grasps.
        joints: indices of the arm's joints.
        before: m along the approach at which the arm stops before it goes straight.
        lift: m straight up with the thing.
        config: of the path to before the thing; the thing itself should not be among its obstacles.

    Raises:
        ConfigurationError: the robot has no parallel gripper.
    """

    def __init__(
        self,
        world: PlacedWorld,
        robot: PlacedRobot,
        joints: list[int],
        before: float = 0.1,
        lift: float = 0.15,
        config: PlannerConfig | None = None,
    ) -> None:
        self._robot, self._joints, self._before, self._lift = robot, joints, before, lift
        self._hand = HandBoxes.of(robot.spec)
        self._planner = JointPlanner(world, robot, joints, config or PlannerConfig())
        frame = robot.spec.end_effector.frame
        tree = KinematicTree(robot.spec.articulation, world.device)
        # Far targets need many starts; the next one along a line is near the last solution.
        many = FullIkConfig(seeds=12, iterations=60)
        near = FullIkConfig(seeds=1, iterations=40)
        self._anywhere, self._nearby = (
            FullIk(tree, frame, joints, robot.position_limits, robot.home_positions, kind) for kind in (many, near)
        )

    def plan(self, pose: Tensor, env: int = 0) -> GraspPlan:
        """Return the plan for a pose (7,) of the end effector, in the environment, in which the gripper closes.

        Raises:
            PlanningError: the pose cannot be reached, by how much; or something is in the way, what and how far.
        """
        return self._plan(self._straight_parts(pose[None], env), 0, None, env)

    def plans(self, candidates: GraspCandidates, thing: Tensor, env: int = 0) -> Iterator[GraspPlan]:
        """Yield a plan for each candidate that has one, the best first.

        Args:
            candidates: in the thing's frame.
            thing: (7,) pose of that frame in the environment's.
            env: index of the environment.

        Raises:
            PlanningError: no candidate has a plan; counts failures by reason. It is raised at the end, after
                no plan was given.
        """
        poses = pose_multiply(thing.expand(len(candidates), 7), candidates.poses.to(thing))
        failed = {_Unreached: 0, _Touching: 0, PlanningError: 0}
        given = False
        for first in range(0, len(poses), _AT_ONCE):
            ways = self._straight_parts(poses[first : first + _AT_ONCE], env)
            for row in range(len(ways.positions)):
                try:
                    plan = self._plan(ways, row, first + row, env)
                except PlanningError as error:
                    failed[type(error)] += 1
                    continue
                given = True
                yield plan
        if not given:
            reasons = zip(("cannot be reached", "touch something", "have no path"), failed.values(), strict=True)
            why = ", ".join(f"{count} {reason}" for reason, count in reasons if count)
            raise PlanningError(f"none of {len(candidates)} grasps has a plan: {why}")

    def _plan(self, ways: _StraightWays, row: int, candidate: int | None, env: int) -> GraspPlan:
        _check_reached(ways, row)
        self._check_hand(ways.poses[row], env)
        approach, lift = ways.positions[row, :_STRAIGHT], ways.positions[row, _STRAIGHT - 1 :]
        # Cheap tests first: the path planner takes most of the time.
        if float(self._planner.clearances(approach[:1], env).min()) < self._planner.config.margin:
            raise _Touching(f"before the thing, {self._planner.touched(approach[0], env)}")
        return GraspPlan(candidate, self._planner.plan(approach[0], env), approach, lift)

    def _check_hand(self, poses: Tensor, env: int) -> None:
        """Reject a straight way (T, 7) on which the open hand enters an obstacle."""
        points = self._hand.points.to(poses)
        placed = quat_rotate(poses[:, None, 3:], points) + poses[:, None, :3]
        distances, _ = self._planner.obstacles.distances(placed, env)
        if not distances.numel() or float(distances.min()) >= 0.0:
            return
        deepest = int(distances.flatten(0, 1).amin(0).argmin())
        name, depth = self._planner.obstacles.names[deepest], -float(distances.min())
        raise _Touching(f"the open hand would be {depth:.3f} m inside '{name}'")

    def _straight_parts(self, poses: Tensor, env: int) -> _StraightWays:
        """Return joint positions through approach and lift for poses (K, 7) at the thing."""
        start = self._robot.joint_positions[env].expand(len(poses), -1)
        ways = torch.linspace(-self._before, 0.0, _STRAIGHT, device=poses.device)
        rises = torch.linspace(0.0, self._lift, _STRAIGHT, device=poses.device)[1:]
        root = pose_inverse(self._robot.root_pose[env].expand(len(poses), 7))
        targets, parts, errors, jumps = [], [], [], []
        full = start.clone()
        # The approach ends at the pose, from which the lift begins.
        for number, (way, rise) in enumerate([(float(w), 0.0) for w in ways] + [(0.0, float(r)) for r in rises]):
            shift = quat_rotate(poses[:, 3:], poses.new_tensor([0.0, 0.0, way]).expand(len(poses), 3))
            target = torch.cat((poses[:, :3] + shift + poses.new_tensor([0.0, 0.0, rise]), poses[:, 3:]), dim=1)
            solver = self._nearby if number else self._anywhere
            found = solver.solve(pose_multiply(root, target), full)
            moved = (found.positions - full[:, self._joints]).abs().amax(1)
            jumps.append(moved * (number > 0))
            full = full.clone()
            full[:, self._joints] = found.positions
            targets.append(target)
            parts.append(found.positions)
            missing = torch.stack((found.position_error, found.rotation_error), dim=1)
            errors.append(torch.where(found.converged[:, None], 0.0, missing))
        stacked = (torch.stack(part, dim=1) for part in (targets, parts, errors, jumps))
        return _StraightWays(*stacked)


class _Unreached(PlanningError):
    """Raised when the arm does not reach a pose."""


class _Touching(PlanningError):
    """Raised when something is in the way."""


@dataclass(frozen=True, eq=False)
class _StraightWays:
    """Approach and lift for K poses, in T postures each."""

    poses: Tensor
    """Poses (K, T, 7) of the hand."""
    positions: Tensor
    """Joint positions (K, T, k)."""
    missing: Tensor
    """Distances (K, T, 2) in m and rad by which the hand misses its pose; zero where it reaches it."""
    jumps: Tensor
    """Largest joint motion (K, T) in rad or m from the previous posture."""


def _check_reached(ways: _StraightWays, row: int) -> None:
    missing = ways.missing[row]
    unreached = missing.amax(1).nonzero()[:, 0]
    if len(unreached):
        step = int(unreached[0])
        where = "before the thing" if step == 0 else "at the thing" if step < _STRAIGHT else "when lifting"
        distance, angle = missing[step].tolist()
        raise _Unreached(
            f"{where} the hand misses the pose by {distance:.3f} m and {angle:.2f} rad: it is out of reach"
        )
    if float(ways.jumps[row].max()) >= _JUMP:
        raise _Unreached("the arm would have to turn over on the straight way: take the thing from another side")


# Share of the joints' velocity limits that grasps use.
_SPEED = 0.5
# Acceleration limits as multiples (1/s) of velocity limits.
_SPEED_UP = 2.0
# Metres around the line between the fingers within which they must touch the thing.
_BETWEEN = 0.005


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """Timed motion of the arm for one grasp."""

    pose: Tensor
    """Pose (7,) of the hand in the environment when the gripper closes."""
    score: float | None
    """Score from 0 to 1; None for a pose that a person gave."""
    reach: JointTrajectory
    """Motion from the present positions to a pose before the grasp."""
    approach: JointTrajectory
    """Straight motion from there to the grasp."""
    lift: JointTrajectory
    """Straight motion upwards with the thing."""


class GraspSearch:
    """Grasp candidates for a thing of a copied world, and motions to them.

    Args:
        world: the copy.
        joints: indices of the arm's joints.
        thing: name of the object.
        dt: s between samples of the motions.

    Raises:
        ArgumentError: the thing cannot be grasped: it is too wide, or has no shape.
        ConfigurationError: the robot has no parallel gripper; or a library is missing.
    """

    def __init__(self, world: StillWorld, joints: list[int], thing: str, dt: float) -> None:
        self._robot, self._joints, self._thing, self._dt = world.robot, joints, thing, dt
        self._pose = world.objects[thing].root_pose[0]
        self._hand = HandBoxes.of(world.robot.spec)
        self.opening = self._hand.opening
        """Distance (m) between the fingers."""
        self._surface = surface_of(world.objects[thing].spec.articulation.links[0])
        up = quat_rotate_inverse(self._pose[None, 3:], self._pose.new_tensor([[0.0, 0.0, 1.0]]))[0]
        self.candidates = grasp_candidates(self._surface, self._hand, GraspConfig(most=32), up.cpu())
        """Grasps by their score, the best first."""
        self.poses = pose_multiply(self._pose.expand(len(self.candidates), 7), self.candidates.poses.to(self._pose))
        """Poses (K, 7) of the candidates in the environment, the best first."""
        self.place = self._pose[:3]
        """Position (3,) in m of the thing when the copy was made."""
        # The thing itself is no obstacle to the hand that takes it.
        others = tuple(name for name in world.objects if name != thing)
        config = PlannerConfig(obstacles=(TERRAIN, *others), time_limit=5.0)
        self._planner = GraspPlanner(world, world.robot, joints, config=config)

    def motions(self) -> Iterator[GraspMotion]:
        """Yield a motion for each candidate that has one, the best first.

        Raises:
            PlanningError: no candidate has one; says why.
        """
        for plan in self._planner.plans(self.candidates, self._pose):
            assert plan.candidate is not None  # they are of candidates
            score = float(self.candidates.scores[plan.candidate])
            yield self._timed(plan, self.poses[plan.candidate], score)

    def motion_to(self, pose: Tensor) -> GraspMotion:
        """Return the motion for a pose (7,) of the hand that a person gave.

        Raises:
            PlanningError: there is none; says why.
        """
        points = transform_points(self._pose[None], self._surface.points.to(pose)[None])[0]
        local = quat_rotate_inverse(pose[None, 3:], points - pose[:3])
        if bool(self._hand.touches(local)):
            raise PlanningError(f"the open hand would be inside '{self._thing}'")
        near = (local[:, 0].abs() < _BETWEEN) & (local[:, 2].abs() < _BETWEEN)
        if not bool((near & (local[:, 1].abs() < 0.5 * self._hand.opening)).any()):
            raise PlanningError(f"nothing of '{self._thing}' is between the fingers: they would close on air")
        return self._timed(self._planner.plan(pose), pose, None)

    def _timed(self, plan: GraspPlan, pose: Tensor, score: float | None) -> GraspMotion:
        limits = joint_limits(self._robot.spec, "velocity_limit")[self._joints]
        # Joints without a velocity limit move at 1 rad/s or m/s.
        limits = np.where(np.isfinite(limits), limits, 1.0)
        parts = (
            time_optimal(part.cpu().numpy(), _SPEED * limits, _SPEED_UP * limits, self._dt)
            for part in (plan.reach, plan.approach, plan.lift)
        )
        return GraspMotion(pose.clone(), score, *parts)
