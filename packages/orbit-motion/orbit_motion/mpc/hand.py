"""Model-predictive control of a hand, moved by its arm and the base that carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.actions.base import CommandMode
from orbit_core.actions.embodiment import base_joints
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_constants
from orbit_core.scene import RobotSpec
from orbit_motion.mpc.predictive import Array, Plan, Predictive, PredictiveConfig, libraries, reduced_model


@dataclass(frozen=True, kw_only=True)
class HandMpcConfig(PredictiveConfig):
    """A command is a pose of the hand, to which arm and planar base follow a plan (model-predictive control).

    At each plan of ``rate`` crocoddyl's solver BoxFDDP (Mastalli et al., Crocoddyl, ICRA 2020; Tassa, Mansard and
    Todorov, Control-Limited Differential Dynamic Programming, ICRA 2014) minimises, over the efforts of ``nodes`` steps
    of ``node_time``, the squares of the hand's distance from the goal, of the joints' from home, of velocities and of
    efforts in shares of their limits. Efforts keep to their limits, positions and velocities are drawn back by a steep
    cost beyond theirs. The arm gets positions and velocities, a base velocities. One environment.
    """

    name: ClassVar[str] = "hand_mpc"

    mode: CommandMode = CommandMode.ABSOLUTE
    position_scale: float = 0.5
    rotation_scale: float = 3.141592653589793

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return (*super().default_joints(spec), *base_joints(spec))

    def build(self, name: str, robot: Robot) -> HandMpc:
        return HandMpc(name, robot, self)


class HandMpc(Predictive):
    """Six commands, :class:`HandMpcConfig`."""

    config: HandMpcConfig
    """Settings, as the action term gives them."""

    def __init__(self, name: str, robot: Robot, config: HandMpcConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, config)
        # A differential base cannot move sideways, which the model's joints could.
        if robot.spec.differential_base is not None and set(joints) & {
            robot.joint_names.index(joint) for joint in base_joints(robot.spec)
        }:
            raise ConfigurationError(
                f"action term '{name}': wheels that cannot roll sideways are not in its model: name the arm's joints"
            )
        self.frame = config.frame_of(robot)
        """Name of the frame that moves."""
        self._pose = config.pose_command(robot)
        libraries()

    def enter(self, world: World, step_dt: float) -> None:
        super().enter(world, step_dt)
        spec = self.robot.spec
        home = dict(zip(self.robot.joint_names, self.robot.home_positions.tolist(), strict=True))
        gravity = (0.0, 0.0, 0.0) if spec.gravity_compensation else tuple(world.scene.gravity)
        model, places = reduced_model(spec.articulation, list(self.limits.names), home, gravity, False)
        self._places = np.asarray(places, dtype=np.int64)
        self._problem = _HandProblem(self, model, np.array([home[name] for name in self.limits.names]))

    def goal(self, command: Tensor) -> Array:
        return self._pose.target(command)[0].double().cpu().numpy()

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def measured(self) -> Array:
        """Return the root's pose, then positions and velocities (7 + 2 k,)."""
        parts = (self.robot.root_pose[0], self.positions[0], self.velocities[0])
        return np.concatenate([part.double().cpu().numpy() for part in parts])

    def solve(self, state: Array, goal: Array, time: float) -> Plan:
        return self._problem.solve(state, goal)

    def ordered(self, values: Array) -> Array:
        """Reorder values (k,) of the term's joints to the model's order."""
        result = np.empty_like(values)
        result[self._places] = values
        return result

    @property
    def places(self) -> npt.NDArray[np.int64]:
        """Index (k,) of each joint in the model."""
        return self._places


class _HandProblem:
    """The optimal control problem, built once, and warm-started by the last solution."""

    def __init__(self, owner: HandMpc, model: Any, home: Array) -> None:
        pinocchio, croc = libraries()
        self._owner, self._model, self._pinocchio = owner, model, pinocchio
        config, limits = owner.config, owner.limits
        state = croc.StateMultibody(model)
        actuation = croc.ActuationModelFull(state)
        self._frame = model.getFrameId(owner.frame, pinocchio.FrameType.OP_FRAME)
        size = model.nv
        self._goal = croc.ResidualModelFramePlacement(state, self._frame, pinocchio.SE3.Identity(), size)
        low, high, speed, effort = (
            owner.ordered(part) for part in (limits.lowest, limits.highest, limits.velocity, limits.effort)
        )
        ends = np.concatenate((low, -speed)), np.concatenate((high, speed))
        still = np.concatenate((owner.ordered(home), np.zeros(size)))
        base = {*base_joints(owner.robot.spec)}
        # A base's position has no home: only the arm is drawn back.
        free = owner.ordered(np.array([0.0 if name in base else 1.0 for name in limits.names]))
        weights = np.concatenate((config.posture_weight * free, np.full(size, config.velocity_weight)))
        # A radian of rotation counts as much as 0.45 m.
        reaching = croc.ActivationModelWeightedQuad(np.array([1.0] * 3 + [0.2] * 3))

        def model_of(last: bool) -> Any:
            costs = croc.CostModelSum(state, size)

            def add(name: str, activation: Any, residual: Any, weight: float) -> None:
                costs.addCost(name, croc.CostModelResidual(state, activation, residual), weight)

            # The end counts more than the way, else the hand stops early.
            add("goal", reaching, self._goal, config.goal_weight * (1.0 if last else 0.3))
            add("rest", croc.ActivationModelWeightedQuad(weights), croc.ResidualModelState(state, still, size), 1.0)
            bounds = croc.ActivationBounds(*ends)
            barrier = croc.ActivationModelQuadraticBarrier(bounds)
            add("limits", barrier, croc.ResidualModelState(state, np.zeros(2 * size), size), 1e4)
            if not last:
                share = croc.ActivationModelWeightedQuad(config.effort_weight / effort**2)
                add("efforts", share, croc.ResidualModelControl(state, size), 1.0)
            dynamics = croc.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
            dynamics.armature = owner.ordered(joint_constants(owner.robot.spec, "armature")[owner.joints])
            step = croc.IntegratedActionModelEuler(dynamics, 0.0 if last else config.node_time)
            step.u_lb, step.u_ub = -effort, effort
            return step

        self._problem = croc.ShootingProblem(still, [model_of(False)] * config.nodes, model_of(True))
        self._solver = croc.SolverBoxFDDP(self._problem)
        self._warm: tuple[list[Array], list[Array]] | None = None

    def solve(self, measured: Array, goal: Array) -> Plan:
        owner, count = self._owner, len(self._owner.joints)
        root, parts = measured[:7], measured[7:].reshape(2, count)
        state = np.concatenate([owner.ordered(part) for part in parts])
        # The model's root is the robot's: the goal is given relative to it.
        self._goal.reference = _pose(self._pinocchio, root).inverse() * _pose(self._pinocchio, goal)
        self._problem.x0 = state
        nodes = self._problem.T
        states, efforts = self._warm or ([state] * (nodes + 1), [np.zeros(count)] * nodes)
        self._solver.solve([state, *states[1:]], efforts, owner.config.iterations, False)
        states, efforts = list(self._solver.xs), list(self._solver.us)
        path, used = np.array(states), np.array(efforts)
        problem = owner.limits.problem(
            path[1:, :count][:, owner.places], path[1:, count:][:, owner.places], used[:, owner.places]
        )
        # A broken plan is no good start for the next.
        self._warm = None if problem else (states, efforts)
        data = self._model.createData()
        self._pinocchio.framesForwardKinematics(self._model, data, path[-1, :count])
        miss = data.oMf[self._frame].actInv(self._goal.reference)
        turn = float(np.linalg.norm(self._pinocchio.log3(miss.rotation)))
        return Plan(
            path[:, :count][:, owner.places], path[:, count:][:, owner.places], used[:, owner.places],
            owner.config.node_time, (float(np.linalg.norm(miss.translation)), turn), problem,
        )  # fmt: skip


def _pose(pinocchio: Any, pose: Array) -> Any:
    w, x, y, z = pose[3:]
    return pinocchio.SE3(pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix(), pose[:3])
