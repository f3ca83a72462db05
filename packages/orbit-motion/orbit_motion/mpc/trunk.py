"""Model-predictive control of a trunk over standing feet, or feet that step by a periodic contact sequence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget
from orbit_core.actions.embodiment import driven_joints
from orbit_core.actions.ik import displaced
from orbit_core.dynamics.transforms import pose_error, quat_rotate_inverse, quat_yaw
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_constants
from orbit_core.scene import RobotSpec
from orbit_motion.mpc.predictive import Array, Limits, Plan, Predictive, PredictiveConfig, libraries, reduced_model


@dataclass(frozen=True, kw_only=True)
class Gait:
    """Cycle of phases.

    Each is a length in s and the feet in the air, as indices into the robot's ``feet``.
    """

    phases: Sequence[tuple[float, tuple[int, ...]]] = ((1.0, ()),)
    """Phases in order, repeated for ever; one phase without feet in the air stands."""
    step_height: float = 0.05
    """m by which a foot is lifted in the middle of its swing."""

    def check(self, term: str, feet: int) -> None:
        """Reject a gait that a robot with this number of feet cannot walk.

        Raises:
            ConfigurationError: a phase has no length, or names a foot that the robot has not, or no foot would stand.
        """
        if not self.phases:
            raise ConfigurationError(f"action term '{term}': its gait has no phases: give one")
        for length, lifted in self.phases:
            if not length > 0.0:
                raise ConfigurationError(f"action term '{term}': a phase of its gait takes {length:g} s: give more")
            if any(not 0 <= foot < feet for foot in lifted) or len(set(lifted)) >= feet:
                raise ConfigurationError(
                    f"action term '{term}': its gait lifts feet {list(lifted)} of {feet}, numbered from 0: name feet "
                    "that the robot has, and leave one on the ground"
                )


def stance_at(gait: Gait, time: float) -> tuple[tuple[int, ...], float]:
    """Return the feet in the air at a time in s, and the share of their swing that is over."""
    time %= sum(length for length, _ in gait.phases)
    for length, lifted in gait.phases:
        if time < length:
            return lifted, time / length
        time -= length
    return gait.phases[-1][1], 1.0


# Squared gradient below which the solver stops.
_ENOUGH = 1e-5
# Factor of the friction coefficient that a planned force may need: the cone is a cost, which yields slightly.
_SLIDING = 1.5


@dataclass(frozen=True, kw_only=True)
class TrunkSettings(PredictiveConfig):
    """Settings of a trunk's plans."""

    above_zero: ClassVar[tuple[str, ...]] = (*PredictiveConfig.above_zero, "friction", "speed", "turn_speed")
    none_below_zero: ClassVar[tuple[str, ...]] = (*PredictiveConfig.none_below_zero, "sway_weight")

    mode: CommandMode = CommandMode.ABSOLUTE
    position_scale: float = 0.1
    rotation_scale: float = 0.3
    rate: float = 50.0
    nodes: int = 20
    node_time: float = 0.02
    iterations: int = 20
    posture_weight: float = 0.05
    """Weight of the squared distance of the legs from home, rad or m."""
    velocity_weight: float = 0.05
    """Weight of squared joint velocities, rad/s or m/s."""
    sway_weight: float = 1.0
    """Weight of the trunk's velocities."""
    speed: float = 0.1
    """Speed (m/s) at which the goal moves to the commanded position."""
    turn_speed: float = 0.4
    """Angular speed (rad/s) of the same."""
    gait: Gait = field(default_factory=Gait)
    """Contact sequence of the feet; all of them stand by default."""
    friction: float = 0.5
    """Friction coefficient of planned contact forces; less than the ground's."""


class TrunkProblem:
    """Planner of a legged robot's joints, warm-started by its last solution.

    Args:
        robot: on feet.
        joints: indices of the joints that move.
        frame: whose pose is the goal.
        limits: of the joints.
        config: weights, gait and horizon.
        gravity: m/s^2, world axes.
    """

    def __init__(
        self, robot: Robot, joints: Sequence[int], frame: str, limits: Limits, config: TrunkSettings,
        gravity: tuple[float, ...],
    ) -> None:  # fmt: skip
        self._pinocchio, self._croc = libraries()
        spec = robot.spec
        positions = dict(zip(robot.joint_names, robot.home_positions.tolist(), strict=True))
        self._model, places = reduced_model(spec.articulation, list(limits.names), positions, gravity, True)
        self._config, self._limits, self._places = config, limits, np.asarray(places)
        home = np.array([positions[name] for name in limits.names])
        self._home = np.empty_like(home)
        self._home[self._places] = home
        kind = self._pinocchio.FrameType.OP_FRAME
        self._frame = self._model.getFrameId(frame, kind)
        self._feet = [self._model.getFrameId(foot, kind) for foot in spec.feet]
        self._state = self._croc.StateMultibody(self._model)
        self._actuation = self._croc.ActuationModelFloatingBase(self._state)
        self._count = len(home)
        self._armature = np.zeros(6 + self._count)
        self._armature[6 + self._places] = joint_constants(spec, "armature")[list(joints)]
        self._effort = np.empty_like(home)
        self._effort[self._places] = limits.effort
        self._weight = float(np.linalg.norm(gravity)) * sum(link.mass for link in spec.articulation.links)
        self._below = self._feet_from_trunk()
        self._warm: tuple[list[Array], list[Array]] | None = None

    def solve(self, measured: Array, goal: Array, time: float) -> Plan:
        """Return a plan from pose, velocity, positions and velocities (13 + 2 k,) to a pose (7,) of the frame."""
        pinocchio, config, count = self._pinocchio, self._config, self._count
        state = self._state_of(measured)
        target = _placement(pinocchio, goal)
        nodes = config.nodes
        times = [time + node * config.node_time for node in range(nodes + 1)]
        data = self._model.createData()
        pinocchio.framesForwardKinematics(self._model, data, state[: 7 + count])
        # The two lowest feet: others may be in the air.
        ground = float(np.mean(sorted(data.oMf[foot].translation[2] for foot in self._feet)[:2]))
        steps = [self._step(target, t, ground, t is times[-1]) for t in times]
        problem = self._croc.ShootingProblem(state, steps[:-1], steps[-1])
        solver = self._croc.SolverBoxFDDP(problem)
        solver.th_stop = _ENOUGH
        states, efforts = self._begin_with(problem, state, nodes)
        solver.solve([state, *states[1:]], efforts, config.iterations, False)
        path, used = np.array(list(solver.xs)), np.array(list(solver.us))
        positions, velocities = path[:, 7 : 7 + count][:, self._places], path[:, 13 + count :][:, self._places]
        efforts = used[:, self._places]
        problem_found = self._limits.problem(positions[1:], velocities[1:], efforts) or self._sliding(problem)
        # A broken plan is no good start for the next.
        self._warm = None if problem_found else (list(solver.xs), list(solver.us))
        pinocchio.framesForwardKinematics(self._model, data, path[-1, : 7 + count])
        miss = data.oMf[self._frame].actInv(target)
        far = float(np.linalg.norm(miss.translation)), float(np.linalg.norm(pinocchio.log3(miss.rotation)))
        return Plan(positions, velocities, efforts, config.node_time, far, problem_found)

    def _state_of(self, measured: Array) -> Array:
        # Velocities of a free flyer are in the body's axes in pinocchio.
        """Convert to the model: base position, quaternion (x, y, z, w), joints; velocities, the base's in its axes."""
        count = self._count
        turn = _placement(self._pinocchio, measured[:7]).rotation
        joints = np.empty((2, count))
        joints[:, self._places] = measured[13:].reshape(2, count)
        quaternion = self._pinocchio.Quaternion(turn).coeffs()
        return np.concatenate(
            (measured[:3], quaternion, joints[0], turn.T @ measured[7:10], turn.T @ measured[10:13], joints[1])
        )

    def _begin_with(self, problem: Any, state: Array, nodes: int) -> tuple[list[Array], list[Array]]:
        """Return the last solution shifted to this plan's time, or efforts that hold the robot where it is."""
        if self._warm is None:
            return [state] * (nodes + 1), list(problem.quasiStatic([state] * nodes))
        shift = min(round(1.0 / (self._config.rate * self._config.node_time)), nodes)
        states, efforts = self._warm
        return states[shift:] + states[-1:] * shift, efforts[shift:] + efforts[-1:] * shift

    def _step(self, target: Any, time: float, ground: float, last: bool) -> Any:
        """Build the model of one node, with the contacts at its time."""
        croc, state, config = self._croc, self._state, self._config
        size = self._actuation.nu
        lifted, share = stance_at(config.gait, time)
        contacts = croc.ContactModelMultiple(state, size)
        costs = croc.CostModelSum(state, size)
        for number, foot in enumerate(self._feet):
            if number in lifted:
                # A swing foot lands where it is below the trunk at home, on a half sine.
                place = (target * self._pinocchio.SE3(np.eye(3), self._below[number])).translation.copy()
                place[2] = ground + config.gait.step_height * np.sin(np.pi * share)
                swing = croc.ResidualModelFrameTranslation(state, foot, place, size)
                costs.addCost(f"swing {number}", croc.CostModelResidual(state, swing), 10.0 * config.goal_weight)
                continue
            axes = self._pinocchio.LOCAL_WORLD_ALIGNED
            # 40 1/s is the gain by which velocities of a contact decay (Baumgarte).
            contact = croc.ContactModel3D(state, foot, np.zeros(3), axes, size, np.array([0.0, 40.0]))
            contacts.addContact(f"foot {number}", contact)
            if not last:
                cone = croc.FrictionCone(np.eye(3), config.friction, 4, True)
                forces = croc.ResidualModelContactFrictionCone(state, foot, cone, size)
                inside = croc.ActivationModelQuadraticBarrier(croc.ActivationBounds(cone.lb, cone.ub))
                costs.addCost(f"cone {number}", croc.CostModelResidual(state, inside, forces), 10.0)
        self._add_costs(costs, target, last)
        dynamics = croc.DifferentialActionModelContactFwdDynamics(state, self._actuation, contacts, costs, 0.0, True)
        dynamics.armature = self._armature
        step = croc.IntegratedActionModelEuler(dynamics, 0.0 if last else config.node_time)
        step.u_lb, step.u_ub = -self._effort, self._effort
        return step

    def _add_costs(self, costs: Any, target: Any, last: bool) -> None:
        """Add the costs of goal, rest, limits and efforts."""
        croc, state, config, count = self._croc, self._state, self._config, self._count
        size = self._actuation.nu
        goal = croc.ResidualModelFramePlacement(state, self._frame, target, size)
        reaching = croc.CostModelResidual(state, goal)
        costs.addCost("goal", reaching, config.goal_weight * (5.0 if last else 1.0))
        # The base is free: it has no weight in the posture.
        rest = np.concatenate((np.zeros(3), [0.0, 0.0, 0.0, 1.0], self._home, np.zeros(6 + count)))
        weights = np.concatenate(
            (
                np.zeros(6),
                np.full(count, config.posture_weight),
                np.full(6, config.sway_weight),
                np.full(count, config.velocity_weight),
            )
        )
        resting = croc.ResidualModelState(state, rest, size)
        costs.addCost("rest", croc.CostModelResidual(state, croc.ActivationModelWeightedQuad(weights), resting), 1.0)
        low, high, fast = np.empty((3, count))
        limits = self._limits
        low[self._places], high[self._places], fast[self._places] = limits.lowest, limits.highest, limits.velocity
        # The base has no limits.
        free = np.full(6, 1e4)
        below = np.concatenate((-free, low - self._home, -free, -fast))
        above = np.concatenate((free, high - self._home, free, fast))
        barrier = croc.ActivationModelQuadraticBarrier(croc.ActivationBounds(below, above))
        costs.addCost("limits", croc.CostModelResidual(state, barrier, resting), 1e3)
        if not last:
            share = croc.ActivationModelWeightedQuad(config.effort_weight / self._effort**2)
            efforts = croc.CostModelResidual(state, share, croc.ResidualModelControl(state, size))
            costs.addCost("efforts", efforts, 1.0)

    def _sliding(self, problem: Any) -> str:
        """Return the contact that the ground cannot give; empty if none."""
        friction = self._config.friction
        for data in problem.runningDatas:
            for name, contact in data.differential.multibody.contacts.contacts.todict().items():
                # A tenth of the weight is tolerance for the solver's error.
                x, y, z = contact.f.linear
                if z < -0.1 * self._weight:
                    return f"{name} would have to pull at the ground with {-z:.3g} N"
                if np.hypot(x, y) > _SLIDING * friction * max(z, 0.0) + 0.1 * self._weight:
                    return f"{name} would slide: it needs {np.hypot(x, y):.3g} N along the ground under {z:.3g} N"
        return ""

    def _feet_from_trunk(self) -> list[Array]:
        """Return positions of the feet at home, in the frame whose pose is the goal."""
        model, pinocchio = self._model, self._pinocchio
        data = model.createData()
        pinocchio.framesForwardKinematics(model, data, np.concatenate((np.zeros(6), [1.0], self._home)))
        trunk = data.oMf[self._frame]
        return [trunk.actInv(data.oMf[foot]).translation for foot in self._feet]


def _placement(pinocchio: Any, pose: Array) -> Any:
    w, x, y, z = pose[3:]
    return pinocchio.SE3(pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix(), pose[:3])


@dataclass(frozen=True, kw_only=True)
class TrunkMpcConfig(TrunkSettings):
    """A command is a pose of the trunk, to which the legs move it along a plan (model-predictive control).

    Zero is the trunk's place at the start of the episode, level, with the axes of its heading. At each plan of
    ``rate`` crocoddyl's solver BoxFDDP minimises, over the efforts of ``nodes`` steps, the squares of the trunk's
    distance from the goal, of the joints' from home, of velocities and of efforts, with the dynamics of the whole body
    and its contacts (Budhiraja, Carpentier, Mastalli and Mansard, Differential Dynamic Programming for Multi-Phase
    Rigid Contact Dynamics, Humanoids 2018). Standing feet do not move, and their forces stay in the friction cone by a
    cost; feet in the air are lifted, and come down where they are below the trunk at home. Joints get positions,
    velocities and efforts. One environment, flat ground.
    """

    name: ClassVar[str] = "trunk_mpc"

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return [spec.articulation.joint_names[joint] for joint in driven_joints(spec)]

    def frame_of(self, robot: Robot) -> str:
        return self.frame or robot.spec.base_link or robot.link_names[0]

    def build(self, name: str, robot: Robot) -> TrunkMpc:
        return TrunkMpc(name, robot, self)


class TrunkMpc(Predictive):
    """Six commands, :class:`TrunkMpcConfig`."""

    config: TrunkMpcConfig
    """Settings, as the action term gives them."""
    targets: ClassVar[tuple[JointTarget, ...]] = (JointTarget.POSITION, JointTarget.VELOCITY, JointTarget.EFFORT)

    def __init__(self, name: str, robot: Robot, config: TrunkMpcConfig) -> None:
        spec = robot.spec
        if spec.fixed_base or not spec.feet:
            raise ConfigurationError(
                f"action term '{name}' moves a trunk on feet, and robot '{spec.name}' has "
                f"{'a fixed base' if spec.fixed_base else 'no feet'}: choose hand_mpc for an arm"
            )
        if config.mode is not CommandMode.ABSOLUTE:
            raise ConfigurationError(f"action term '{name}': the trunk's commands are absolute")
        super().__init__(name, robot, config.joint_indices(spec, name), config)
        config.gait.check(name, len(spec.feet))
        self.frame = config.frame_of(robot)
        """Name of the frame that moves."""
        robot.frame_pose(self.frame)  # rejects an unknown frame
        self._scale = torch.tensor([config.position_scale] * 3 + [config.rotation_scale] * 3, device=self.device)
        self._fastest = torch.tensor([config.speed] * 3 + [config.turn_speed] * 3, device=self.device) / config.rate
        self._drawn = torch.zeros(1, 6, device=self.device)
        self._origin: Tensor | None = None
        libraries()

    def enter(self, world: World, step_dt: float) -> None:
        super().enter(world, step_dt)
        self._problem = TrunkProblem(
            self.robot, self.joints, self.frame, self.limits, self.config, tuple(world.scene.gravity)
        )

    def goal(self, command: Tensor) -> Array:
        ahead = (command * self._scale - self._drawn) / self._fastest
        # Position and rotation arrive together: all of them at the speed of the slowest.
        self._drawn = self._drawn + self._fastest * ahead / ahead.abs().max().clamp_min(1.0)
        return displaced(self._began(), self._turned(self._drawn))[0].double().cpu().numpy()

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        origin = self._began()
        parts = pose_error(origin, pose).unflatten(1, (2, 3))
        local = quat_rotate_inverse(origin[:, None, 3:].expand(-1, 2, 4), parts).flatten(1)
        return (local / self._scale).clamp(-1.0, 1.0)

    def measured(self) -> Array:
        """Return pose and velocity of the root, then positions and velocities (13 + 2 k,)."""
        robot = self.robot
        parts = (robot.root_pose[0], robot.root_velocity[0], self.positions[0], self.velocities[0])
        return np.concatenate([part.double().cpu().numpy() for part in parts])

    def solve(self, state: Array, goal: Array, time: float) -> Plan:
        return self._problem.solve(state, goal, time)

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        self._origin = None
        self._drawn = torch.zeros_like(self._drawn)

    def _began(self) -> Tensor:
        """Return the trunk's pose (1, 7) at the start of the episode, level."""
        if self._origin is None:
            pose = self.robot.frame_pose(self.frame)
            self._origin = torch.cat((pose[:, :3], quat_yaw(pose[:, 3:])), 1)
        return self._origin

    def _turned(self, local: Tensor) -> Tensor:
        """Rotate a displacement (1, 6) from the origin's axes to the world's."""
        # The inverse quaternion undoes ``quat_rotate_inverse``.
        inverse = self._began()[:, None, 3:] * torch.tensor([1.0, -1.0, -1.0, -1.0], device=self.device)
        return quat_rotate_inverse(inverse.expand(-1, 2, 4), local.unflatten(1, (2, 3))).flatten(1)
