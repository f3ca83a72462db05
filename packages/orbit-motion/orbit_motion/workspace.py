"""Workspace of a robot's hand: the largest box that it reaches, pointing down."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_assets.catalogue import robot
from orbit_core.actions.embodiment import joint_commands
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
)
from orbit_core.envs.task import ROBOT
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.layout import home_positions, match_names
from orbit_core.mdp.common import placed_workspace
from orbit_core.scene import Pose, RobotSpec, Workspace
from orbit_core.scene.pose import Vector3
from orbit_motion.full_ik import FullIk, FullIkConfig

# Tilt and yaw in rad, the widest first
_ROTATIONS = ((0.3, 1.0), (0.0, 1.0), (0.0, 0.0))
# Of the grid along x, y and z
_NODES = (7, 7, 6)
# Joint positions that show how far the grid must extend
_SAMPLES = 32768
# Least cosine between the hand's approach and straight down of the samples that count
_DOWN = math.cos(0.3)
# Samples below which no grid is tried
_FEWEST = 20
# m above the table at which a hand grasps what stands on it
_GRASP_HEIGHT = 0.03
# Part of the arm's reach that the box keeps above the table: the hand does not touch it, tilted as it may be
_CLEARANCE = 0.08
# m above the floor, of a hand on a robot that moves
_LOWEST_ABOVE_FLOOR = 0.3
# Part of its range that each joint keeps from its limits
_MARGIN = 0.03
_SEARCH = FullIkConfig(seeds=4, iterations=40, position_tolerance=2e-3, rotation_tolerance=2e-2)
# Nodes of the box along each axis, at least
_LEAST = 2


def with_workspace(spec: RobotSpec) -> RobotSpec:
    """Return the robot with a workspace of its first end effector: its own, or else a computed one.

    The result is the same at each call; seconds are spent where it is computed.

    Raises:
        ConfigurationError: the robot has no workspace, and its hand cannot point down anywhere that a task would use.
    """
    if spec.end_effector.workspace is not None:
        return spec
    first, *others = spec.end_effectors
    return replace(spec, end_effectors=(replace(first, workspace=fitted_workspace(spec)), *others))


def fitted_workspace(spec: RobotSpec) -> Workspace:
    """Compute the largest box of a grid whose nodes the first end effector reaches, in the root link's frame.

    Raises:
        ConfigurationError: there is none.
    """
    arm = _Arm.of(spec)
    axes = [np.linspace(low, high, count) for (low, high), count in zip(arm.extents, _NODES, strict=True)]
    places = torch.tensor(list(itertools.product(*axes)), dtype=torch.float32)
    straight = arm.reached(places, 0.0, 0.0).numpy().reshape(_NODES)
    on_table = np.ones(_NODES[:2], dtype=bool)
    if arm.table is not None:
        feet = torch.tensor(list(itertools.product(*axes[:2], (arm.table + _GRASP_HEIGHT,))), dtype=torch.float32)
        on_table = arm.reached(feet, 0.0, 0.0).numpy().reshape(_NODES[:2])
    for tilt, yaw in _ROTATIONS:
        good = straight & on_table[..., None]
        if good.any() and (tilt or yaw):
            good[good] = arm.reached(places[torch.as_tensor(good.ravel())], tilt, yaw).numpy()
        box = _largest_box(good)
        if box is not None:
            (i, j, k), (a, b, c) = box
            x, y, z = (axis.tolist() for axis in axes)
            ahead = Workspace((x[i], y[j], z[k]), (x[a], y[b], z[c]), tilt, yaw)
            return ahead.placed(_turn_of(spec).inverse())
    raise _none_found(spec)


@dataclass(frozen=True, eq=False)
class _Arm:
    """The inverse kinematics of a robot's first end effector, in axes of the environment at the robot's root."""

    solver: FullIk
    turn: Tensor
    """(4,) from the environment's axes to the root link's."""
    home: Tensor
    extents: tuple[tuple[float, float], ...]
    """Ranges of x, y and z, m, within which the hand points down, ahead of the robot and over the table."""
    table: float | None
    """Height of the table's top, m; None for a robot that drives or walks up to things."""

    @staticmethod
    def of(spec: RobotSpec) -> _Arm:
        articulation, effector = spec.articulation, spec.end_effector
        tree = KinematicTree(articulation)
        joints = match_names(effector.arm_joints, articulation.joint_names, "joint", f"the arm of '{spec.name}'")
        home = torch.as_tensor(home_positions(spec), dtype=torch.float32)
        limits = _commanded_limits(spec, home)
        turn = torch.tensor(_turn_of(spec).inverse().orientation)
        stands = spec.fixed_base and spec.planar_base is None and not spec.wheels
        floor = -spec.pose.position[2]
        positions = home.repeat(_SAMPLES, 1)
        low, high = limits[joints].clamp(-torch.pi, torch.pi).unbind(1)
        drawn = torch.rand(_SAMPLES, len(joints), generator=torch.Generator().manual_seed(0))
        positions[:, joints] = low + drawn * (high - low)
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).expand(_SAMPLES, 7)
        hands = tree.frame_pose(tree.forward(root, positions), effector.frame)
        back = quat_conjugate(turn).expand(_SAMPLES, 4)
        places = quat_rotate(back, hands[:, :3])
        approach = quat_rotate(back, quat_rotate(hands[:, 3:], torch.tensor([0.0, 0.0, 1.0]).expand(_SAMPLES, 3)))
        reach = float(places.norm(dim=1).max())
        lowest = floor + (_CLEARANCE * reach if stands else _LOWEST_ABOVE_FLOOR)
        ahead = (places[:, 0] > places[:, 1].abs()) & (places[:, 2] > lowest) & (approach[:, 2] < -_DOWN)
        found = places[ahead]
        if len(found) < _FEWEST:
            raise _none_found(spec)
        ends = found.quantile(torch.tensor([0.02, 0.98]), dim=0)
        ends[0, 2] = lowest
        extents = tuple((float(first), float(last)) for first, last in ends.T)
        solver = FullIk(tree, effector.frame, joints, limits, home, _SEARCH)
        return _Arm(solver, turn, home, extents, floor if stands else None)

    def reached(self, places: Tensor, tilt: float, yaw: float) -> Tensor:
        """Return (M,) bool: places (M, 3) at which the hand takes every extreme of tilt and yaw."""
        rotations = {*itertools.product((-tilt, tilt), (-tilt, tilt), (-yaw, yaw))}
        places = quat_rotate(self.turn.expand(len(places), 4), places)
        zero = torch.zeros(())
        good = torch.ones(len(places), dtype=torch.bool)
        for roll, pitch, turn in torch.tensor(sorted(rotations)):
            left = good.nonzero()[:, 0]  # a place that one rotation rules out is tried no more
            if not len(left):
                break
            down = quat_from_euler(zero + math.pi, zero, turn)
            tilted = quat_multiply(quat_from_euler(roll, pitch, zero), down)
            rotation = quat_multiply(self.turn, tilted).expand(len(left), 4)
            poses = torch.cat((places[left], rotation), dim=1)
            good[left] = self.solver.solve(poses, self.home.repeat(len(left), 1)).converged
        return good


def _none_found(spec: RobotSpec) -> ConfigurationError:
    """Return the error of a robot whose hand points down over no stretch of the table."""
    return ConfigurationError(
        f"robot '{spec.articulation.name}' has no workspace, and none was found: ahead of it, along x, "
        f"'{spec.end_effector.frame}' points straight down over no stretch of the table. Turn the robot's pose if its "
        "arm faces another way, check the frame's axes and the home pose ('orbit check-robot'), give its end effector "
        "a workspace, or choose another robot"
    )


def _turn_of(spec: RobotSpec) -> Pose:
    """Return the orientation in which the robot stands in a scene."""
    return Pose((0.0, 0.0, 0.0), spec.pose.orientation)


def _commanded_limits(spec: RobotSpec, home: Tensor) -> Tensor:
    """(J, 2) limits of the joints, less a margin, and no farther from home than actions command them."""
    joints = spec.articulation.movable_joints
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in joints], dtype=torch.float32)
    low, high = limits.unbind(1)
    inside = torch.where(limits.isfinite().all(1), _MARGIN * (high - low), 0.0)
    # What a walker's own commands allow is for its legs.
    scale = torch.inf if spec.feet else joint_commands(spec).position_scale or torch.inf
    low, high = torch.maximum(low + inside, home - scale), torch.minimum(high - inside, home + scale)
    return torch.stack((torch.minimum(low, home), torch.maximum(high, home)), dim=1)


def _largest_box(good: npt.NDArray[np.bool_]) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Return the lowest and highest node (i, j, k) of the largest box of True nodes; None where each is too thin."""
    table = np.zeros([size + 1 for size in good.shape], dtype=int)
    table[1:, 1:, 1:] = good.cumsum(0).cumsum(1).cumsum(2)
    ranges = [[(low, high) for low in range(size) for high in range(low + _LEAST - 1, size)] for size in good.shape]
    best, most = None, 0
    for (i, a), (j, b), (k, c) in itertools.product(*ranges):
        size = (a - i + 1) * (b - j + 1) * (c - k + 1)
        if size <= most:
            continue
        a1, b1, c1 = a + 1, b + 1, c + 1
        inside = (
            table[a1, b1, c1] - table[i, b1, c1] - table[a1, j, c1] - table[a1, b1, k]
            + table[i, j, c1] + table[i, b1, k] + table[a1, j, k] - table[i, j, k]
        )  # fmt: skip
        if inside == size:
            best, most = ((i, j, k), (a, b, c)), size
    return best


# Robots of the catalogue as agents of a task: arms with a workspace that is large enough, and legged robots.

# Least size of a workspace, m, in which a task lays out its things; those of the catalogue's larger arms have more.
ROOM: Vector3 = (0.15, 0.3, 0.2)
# The same for hands that lean, whose arms are small ones for a desk.
_LEANING_ROOM: Vector3 = (0.1, 0.2, 0.12)


def arm(
    name: str,
    gripper: bool = True,
    agent: str = ROBOT,
    pose: Pose | None = None,
    room: Vector3 = ROOM,
    leans: bool = False,
) -> RobotSpec:
    """A robot of the catalogue with an end effector, and a gripper on it where that is needed, as an agent of the task.

    A task that leads hands through :func:`orbit_core.mdp.common.leaning` says that it ``leans``: it gets small arms
    that cannot point straight down, with the workspace of their :class:`orbit_core.scene.Lean`.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it has no end effector, no arm that moves it, or no gripper; or it has no workspace, and
            none is found (:func:`orbit_motion.workspace.with_workspace`), or one that is smaller than the task's
            ``room``, m along x, y and z.
    """
    spec = robot(name, name=agent)
    spec = spec if pose is None else replace(spec, pose=pose)
    lacking = None
    if not spec.end_effectors:
        lacking = "end effector"
    elif not spec.has_arm:
        raise ConfigurationError(
            f"robot '{name}' has no arm, which this task needs: mount it on one, as in 'ur10+{name}', or choose "
            "another robot"
        )
    elif gripper and spec.end_effector.gripper is None:
        lacking = "gripper"
    if lacking:
        raise ConfigurationError(f"robot '{name}' has no {lacking}, which this task needs: choose another robot")
    lean = spec.end_effector.lean
    if leans and lean is not None:
        first, *others = spec.end_effectors
        spec = replace(spec, end_effectors=(replace(first, workspace=lean.workspace), *others))
        room = _LEANING_ROOM
    spec = with_workspace(spec)
    box = placed_workspace(spec)
    size = [high - low for low, high in zip(box.low, box.high, strict=True)]
    if any(has < needs for has, needs in zip(size, room, strict=True)):
        sizes = (" x ".join(f"{length:.2f}" for length in lengths) for lengths in (size, room))
        raise ConfigurationError(
            "the workspace of robot '{}' is {} m, and this task needs {} m: choose a larger robot".format(name, *sizes)
        )
    return spec


def legged(name: str) -> RobotSpec:
    """A robot of the catalogue with feet, as the task's robot.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it has no feet.
    """
    spec = robot(name, name=ROBOT)
    if not spec.feet:
        raise ConfigurationError(f"robot '{name}' has no feet, which this task needs: choose another robot")
    return spec
