"""Motion generator that plans ahead, at its own rate and in its own thread, and follows its latest plan."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_core.scene import Articulation, JointType, Pose

# Pinocchio's model of an articulation, built from the description, without a file in between --------------------------

ROOT_JOINT = "root_joint"
"""Name by which crocoddyl finds the joint of a floating base, which no actuator drives."""


def libraries() -> tuple[Any, Any]:
    """Return the modules pinocchio and crocoddyl.

    Raises:
        ConfigurationError: they are not installed; says what to install.
    """
    try:
        return import_module("pinocchio"), import_module("crocoddyl")
    except ImportError:
        raise ConfigurationError(
            "model-predictive control needs crocoddyl and the release of Pinocchio that it was made with: "
            f"{install_extra('mpc')} and pip install --no-deps crocoddyl==3.2.1 libcrocoddyl==3.2.1"
        ) from None


def pinocchio_model(articulation: Articulation, floating: bool = False) -> tuple[Any, dict[str, int]]:
    """Return the model, and pinocchio's index of each movable joint; joints that follow others count as free.

    Every link and named frame is a frame of the model. A floating base has the joint :data:`ROOT_JOINT` at the root
    link's frame.

    Args:
        articulation: in topological order.
        floating: True if the root link moves.
    """
    pinocchio: Any = import_module("pinocchio")

    def placement(pose: Pose) -> Any:
        matrix = pose.matrix()
        return pinocchio.SE3(matrix[:3, :3], matrix[:3, 3])

    def add_body(name: str, parent: int, frame: Any) -> None:
        link = articulation.links[names.index(name)]
        parents[name], frames[name] = parent, frame
        own = pinocchio.Inertia(link.mass, np.asarray(link.center_of_mass), np.asarray(link.inertia))
        model.appendBodyToJoint(parent, own, frame)

    model, names = pinocchio.Model(), articulation.link_names
    parents: dict[str, int] = {}
    frames: dict[str, Any] = {}
    ids: dict[str, int] = {}
    identity = pinocchio.SE3.Identity()
    root = model.addJoint(0, pinocchio.JointModelFreeFlyer(), identity, ROOT_JOINT) if floating else 0
    if floating:
        model.addJointFrame(root)
    add_body(names[0], root, identity)
    kinds = {JointType.PRISMATIC: pinocchio.JointModelPrismaticUnaligned}
    for joint in articulation.joints:
        before = frames[joint.parent] * placement(joint.parent_pose)
        parent = parents[joint.parent]
        if joint.movable:
            kind = kinds.get(joint.type, pinocchio.JointModelRevoluteUnaligned)
            parent = model.addJoint(parent, kind(np.asarray(joint.axis)), before, joint.name)
            model.addJointFrame(parent)
            # A link's body is placed in its joint's frame, in which pinocchio has it.
            ids[joint.name], before = parent, identity
        add_body(joint.child, parent, before * placement(joint.child_pose).inverse())
    for name in names:
        model.addFrame(pinocchio.Frame(name, parents[name], frames[name], pinocchio.FrameType.OP_FRAME))
    # Frames with a link's name exist already.
    for frame in articulation.frames:
        if frame.name not in names:
            at = frames[frame.link] * placement(frame.pose)
            model.addFrame(pinocchio.Frame(frame.name, parents[frame.link], at, pinocchio.FrameType.OP_FRAME))
    return model, ids


def reduced_model(
    articulation: Articulation,
    joints: Sequence[str],
    positions: Mapping[str, float],
    gravity: Sequence[float],
    floating: bool,
) -> tuple[Any, list[int]]:
    """Return the model of some joints, and the index of each among its joints.

    Args:
        articulation: the description.
        joints: names of those that move.
        positions: rad or m at which all others are held, by name.
        gravity: m/s^2, world axes.
        floating: True if the root link moves.
    """
    pinocchio: Any = import_module("pinocchio")
    model, ids = pinocchio_model(articulation, floating)
    held = [name for name in articulation.joint_names if name not in joints]
    reference = pinocchio.neutral(model)
    for name in held:
        reference[model.joints[ids[name]].idx_q] = positions[name]
    model = pinocchio.buildReducedModel(model, [ids[name] for name in held], reference)
    model.gravity.linear = np.asarray(gravity, dtype=np.float64)
    # A floating base has six velocity coordinates before the joints.
    base = 6 if floating else 0
    return model, [model.joints[model.getJointId(name)].idx_v - base for name in joints]


Array = npt.NDArray[np.float64]
# rad or m by which a plan may pass a position limit: limits are costs, which yield slightly.
_BEYOND = 0.02
# Factor by which a plan may exceed a velocity or effort limit.
_TOO_FAST = 1.1


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion of k joints from now on."""

    positions: Array
    """Positions (T + 1, k)."""
    velocities: Array
    """Velocities (T + 1, k)."""
    efforts: Array
    """Efforts (T, k)."""
    dt: float
    """Seconds between rows."""
    missing: tuple[float, float]
    """Distance in m and rad by which the end misses the goal."""
    problem: str = ""
    """Constraint that the plan breaks; empty if it keeps all."""

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return positions, velocities and efforts (k,) ``time`` seconds later; the end is held."""
        place = min(time / self.dt, len(self.efforts))
        before = min(int(place), len(self.efforts) - 1)
        share = place - before
        positions, velocities = (
            (1.0 - share) * part[before] + share * part[before + 1] for part in (self.positions, self.velocities)
        )
        return positions, velocities, self.efforts[before]


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of k joints, by name."""

    names: Sequence[str]
    """Names of the joints."""
    lowest: Array
    """(k,) rad or m."""
    highest: Array
    """(k,) rad or m."""
    velocity: Array
    """(k,) rad/s or m/s."""
    effort: Array
    """(k,) N m or N."""

    def problem(self, positions: Array, velocities: Array, efforts: Array) -> str:
        """Return the limit that a motion (T, k) exceeds most; empty if none."""
        if not all(np.isfinite(part).all() for part in (positions, velocities, efforts)):
            return "the solver found no motion: its numbers are not finite"
        beyond = np.maximum(self.lowest - positions, positions - self.highest).max(0)
        fast = (np.abs(velocities) / self.velocity).max(0)
        strong = (np.abs(efforts) / self.effort).max(0)
        if beyond.max() > _BEYOND:
            return f"joint '{self.names[int(beyond.argmax())]}' would pass its limit by {beyond.max():.3g} rad or m"
        if fast.max() > _TOO_FAST:
            return f"joint '{self.names[int(fast.argmax())]}' would move at {fast.max():.3g} times its velocity limit"
        if strong.max() > _TOO_FAST:
            return f"joint '{self.names[int(strong.argmax())]}' would need {strong.max():.3g} times its effort limit"
        return ""


@dataclass(frozen=True, kw_only=True)
class PredictiveConfig(PoseTermConfig):
    """Settings of predictive controllers: horizon and rate."""

    above_zero: ClassVar[tuple[str, ...]] = (
        *PoseTermConfig.above_zero, "rate", "nodes", "node_time", "iterations", "goal_weight",
    )  # fmt: skip
    none_below_zero: ClassVar[tuple[str, ...]] = ("posture_weight", "velocity_weight", "effort_weight")

    rate: float = 25.0
    """Plans per second. A plan starts from the measured state, is computed while the world continues, and is followed
    from when the next one is begun: the result does not depend on the computer's speed."""
    nodes: int = 20
    """Steps of the horizon."""
    node_time: float = 0.04
    """Seconds of a step."""
    iterations: int = 5
    """Most iterations of the solver for each plan, which begins with the last one."""
    goal_weight: float = 100.0
    """Weight of the squared distance to the goal, m and rad."""
    posture_weight: float = 0.005
    """Weight of the squared distance from home, rad or m."""
    velocity_weight: float = 0.05
    """Weight of squared joint velocities, rad/s or m/s."""
    effort_weight: float = 0.01
    """Weight of efforts, as shares of their limits."""


class Predictive(MotionGenerator):
    """Targets along the newest plan; if it breaks a constraint the joints hold still, and :attr:`problem` says why.

    Raises:
        ConfigurationError: the world has several environments; the rate does not divide that of commands; crocoddyl is
            not installed; a joint has no limit of effort.
    """

    targets: ClassVar[tuple[JointTarget, ...]] = (JointTarget.POSITION, JointTarget.VELOCITY)

    def __init__(self, name: str, robot: Robot, joints: Sequence[int], config: PredictiveConfig) -> None:
        super().__init__(name, robot, joints, 6, self.targets)
        if self.num_envs != 1:
            raise ConfigurationError(
                f"action term '{name}' plans for one environment and the world has {self.num_envs}: make it with "
                "num_envs=1, or take a generator that is batched"
            )
        self.config = config
        """Settings, as the action term gives them."""
        self.problem = ""
        """Reason why the joints hold still; empty while they follow a plan."""
        self.plan: Plan | None = None
        """The plan that is followed."""
        self._held: tuple[Array, Array, Array] | None = None
        self._turn, self._begun = 0, 0
        self._pending: Future[Plan] | None = None
        # Created with the first plan: a generator that is only described needs no thread.
        self._thread: ThreadPoolExecutor | None = None
        limits = [joint_limits(robot.spec, what)[self.joints] for what in ("velocity_limit", "effort_limit")]
        for joint, effort in zip(self.joints, limits[1], strict=True):
            if not effort > 0.0:
                raise ConfigurationError(
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {effort:g}, so that action "
                    f"term '{name}' cannot plan for it: raise the limit, or name other joints"
                )
        # Crocoddyl needs finite limits: these are beyond any motion.
        speed, effort = (np.where(np.isfinite(limit), limit, 1e4) for limit in limits)
        low, high = self.lower_limits.double().cpu().numpy(), self.upper_limits.double().cpu().numpy()
        names = [robot.joint_names[joint] for joint in self.joints]
        self.limits = Limits(names, np.maximum(low, -1e4), np.minimum(high, 1e4), speed, effort)
        """Limits of the joints that are planned for, finite as the solver needs them."""

    @property
    def missing(self) -> tuple[float, float]:
        """Error of the end of the plan in m and rad, infinite while there is no plan."""
        return self.plan.missing if self.plan is not None else (float("inf"), float("inf"))

    @abstractmethod
    def goal(self, command: Tensor) -> Array:
        """Return the pose (7,) of the frame that a command (1, 6) requests, world axes."""

    @abstractmethod
    def measured(self) -> Array:
        """Return the state from which :meth:`solve` plans."""

    @abstractmethod
    def solve(self, state: Array, goal: Array, time: float) -> Plan:
        """Return a plan from a state ``time`` s after the episode's beginning; called in the generator's thread."""

    def enter(self, world: World, step_dt: float) -> None:
        turns = 1.0 / (self.config.rate * step_dt)
        self._period = round(turns)
        if self._period < 1 or abs(turns - self._period) > 1e-6 * turns:
            raise ConfigurationError(
                f"action term '{self.name}': plans at {self.config.rate:g} Hz do not fall on commands at "
                f"{1.0 / step_dt:g} Hz: choose a rate that divides that"
            )
        self._step_dt = step_dt

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        # Reading a number from a tensor makes a captured step run this Python.
        finite = bool(torch.isfinite(inputs["command"]).all().item())
        if self._turn % self._period == 0:
            self._take_up(inputs["command"] if finite else None)
        since = (self._turn - self._begun) * self._step_dt
        self._turn += 1
        values = self._held if self.plan is None or self.problem else self.plan.at(since)
        assert values is not None
        rows = [torch.as_tensor(value, dtype=torch.float32, device=self.device)[None] for value in values]
        rows[0] = torch.clamp(rows[0], self.lower_limits, self.upper_limits)
        return {target.value: rows[_ORDER.index(target)] for target in self.targets}

    def reset(self, env_ids: Tensor | None = None) -> None:
        # The thread must be done: it reads the problem that the next episode changes.
        if self._pending is not None:
            self._pending.result()
        self.plan, self._pending, self._held, self.problem, self._turn = None, None, None, "", 0

    def _take_up(self, command: Tensor | None) -> None:
        """Follow the plan that was begun last, and begin the next."""
        if command is None:
            self._hold("a command is not a number")
            return
        begun, following = self._turn, self._pending is not None
        if self._pending is None:  # an episode begins: there is nothing to follow meanwhile
            self._begin(command)
        assert self._pending is not None
        plan = self._pending.result()
        if plan.problem:
            self._hold(plan.problem)
        else:
            self.plan, self.problem, self._held = plan, "", None
        # A plan that was begun one period ago has been running since then.
        self._begun = begun - self._period if following else begun
        self._begin(command)

    def _begin(self, command: Tensor) -> None:
        self._thread = self._thread or ThreadPoolExecutor(1, thread_name_prefix=self.name)
        state, goal, time = self.measured(), self.goal(command), self._turn * self._step_dt
        self._pending = self._thread.submit(self.solve, state, goal, time)

    def _hold(self, problem: str) -> None:
        """Hold the joints where they are."""
        if self._held is None:
            positions = self.positions[0].double().cpu().numpy()
            self._held = positions, np.zeros_like(positions), np.zeros_like(positions)
        if problem != self.problem:
            warnings.warn(f"action term '{self.name}' holds still: {problem}", stacklevel=2)
        self.problem = problem


_ORDER = (JointTarget.POSITION, JointTarget.VELOCITY, JointTarget.EFFORT)
