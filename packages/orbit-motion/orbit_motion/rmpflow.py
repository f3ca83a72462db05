"""Reaching around obstacles: Riemannian motion policies, combined in joint space.

Ratliff et al., Riemannian Motion Policies, arXiv:1801.02854, 2018; Cheng et al., RMPflow: A Computational Graph for
Automatic Motion Policy Generation, WAFR 2018. In its own space each policy states the acceleration a that it requests
and, by a metric G, how much that counts. With J the Jacobian of the space, the joints minimise the sum of all:
``a = (sum J^T M J)^-1 sum J^T (f - M J' v)``, M the metric with its curvature, f the requested force.

Metrics that change with the state are :class:`Barrier` spaces, with all their curvature terms. Of ``J' v`` the shapes'
own curvature is left out, which takes away from a convex shape and never towards it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget, LastTargets
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.ik import PoseFollower
from orbit_core.dynamics.kinematics import KinematicTree, drift_at
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import pose_error, quat_rotate
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.fusion import Fused
from orbit_motion.obstacles import Clearance, Obstacles

# Share of the range below which a distance counts as this in the metric: float32 resolves what is left free.
_NEAREST = 0.03
# The same of the margin, in the potential.
_TOUCHING = 0.05


@dataclass(frozen=True)
class Barrier:
    """The collision leaf of Cheng et al. (RMPflow, WAFR 2018, appendix on collision avoidance) for a distance x >= 0.

    With ``s = x / range`` and the speed ``v = x' / speed``, a geometric dynamical system of the metric

    ``G = weight w(s) u(v)``, ``w = (1/s^2 - 1)^2`` within the range, ``u = v^2`` while x shrinks, else 0,

    whose w is theirs, ``1/s^4``, near the obstacle, and goes to zero at the range. Its curvature terms
    ``Xi = x'/2 dG/dx'`` and ``xi = x'^2/2 dG/dx`` make the inertia ``M = G + Xi`` and the force ``-xi``, by which what
    comes nearer slows down with the distance, ``x' ~ x`` where nothing drives it, and nothing is felt at rest or on
    leaving. Only within ``margin`` a potential pushes, with ``push (margin / x - 1)^2``.
    """

    weight: float
    """Factor of the metric."""
    range: float
    """m or rad within which the barrier acts."""
    speed: float
    """m/s or rad/s at which ``u`` is 1."""
    margin: float
    push: float
    """Force at half the margin, in units of the metric times m/s^2."""

    def __call__(self, distance: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Inertia M and force f (...) at distances x (...), with their speeds x' (...)."""
        share = (distance / self.range).clamp_min(_NEAREST)
        root = (share.square().reciprocal() - 1.0).clamp_min(0.0)
        square = (speed.clamp_max(0.0) / self.speed).square()
        # dw/dx = -4 root / s^3 / range; x'^2 dG/dx / 2 then is this, and Xi equals G, as u is quadratic.
        slope = -4.0 * root / share.pow(3) / self.range
        inertia = 2.0 * self.weight * root.square() * square
        near = distance.clamp_min(_TOUCHING * self.margin)
        pushing = self.push * (self.margin / near - 1.0).clamp_min(0.0).square()
        return inertia, pushing - 0.5 * self.weight * slope * square * speed.square()


@dataclass(frozen=True, kw_only=True)
class RmpFlowConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, to which the hand goes around obstacles.

    Policies: the goal draws the hand's position and rotation; every ball that covers a moved link is slowed down before
    every obstacle within ``range``, and joints before their limits; they are drawn home and damped. The motion is
    integrated from the measured state of an episode's beginning, within ``max_lead`` of the measured positions, and
    sent to the drives as positions and velocities. It is a local method: it can get stuck before an obstacle.
    """

    name: ClassVar[str] = "rmpflow"
    above_zero: ClassVar[tuple[str, ...]] = (
        *PoseTermConfig.above_zero,
        "margin",
        "range",
        "goal_gain",
        "goal_reach",
        "goal_turn",
        "obstacle_speed",
        "posture_weight",
        "substeps",
        "max_lead",
    )
    none_below_zero: ClassVar[tuple[str, ...]] = ("obstacle_weight", "obstacle_push", "posture_gain", "limit_weight")
    unbounded: ClassVar[tuple[str, ...]] = (*PoseTermConfig.unbounded, "goal_reach", "goal_turn", "max_lead")

    mode: CommandMode = CommandMode.ABSOLUTE
    position_scale: float = 0.5
    rotation_scale: float = 3.141592653589793
    obstacles: tuple[str, ...] | None = None
    """Names of objects, and "terrain"; None takes what stands still: the terrain, and of all objects whose base
    is fixed the links that no joint moves, so not drawers or doors. What a ball of the robot touches at home, such as
    the table that it stands on, is no obstacle to that ball."""
    margin: float = 0.0035
    """m from an obstacle within which it pushes, which keeps still what the goal would press on it."""
    range: float = 0.05
    """m within which an obstacle slows down what comes nearer."""
    goal_gain: float = 50.0
    """1/s^2 near the goal."""
    goal_reach: float = 0.15
    """m beyond which the goal draws no more strongly."""
    goal_turn: float = 0.6
    """rad beyond which it turns no more strongly."""
    obstacle_weight: float = 0.3
    """Metric of an obstacle at 0.7 of the range, at a speed of ``obstacle_speed``, where the goal's is one."""
    obstacle_speed: float = 0.1
    """m/s"""
    obstacle_push: float = 0.1
    """N, as the goal's metric is a kilogram: by which it pushes at half the margin."""
    posture_gain: float = 1.0
    """1/s^2 that draws joints home."""
    posture_weight: float = 0.01
    """Metric of the pull towards home, where the goal's is one."""
    limit_weight: float = 0.01
    """As ``obstacle_weight``, of the last 0.2 rad or m before a joint's limit, at 1 rad/s or m/s."""
    substeps: int = 4
    """Steps of integration for one command."""
    max_lead: float = 0.3
    """rad or m by which targets may lead the measured positions."""

    def build(self, name: str, robot: Robot) -> RmpFlow:
        return RmpFlow(name, robot, self)


class RmpFlow(PoseFollower):
    """Six commands, :class:`RmpFlowConfig`. Targets keep to the joints' limits of position and velocity."""

    def __init__(self, name: str, robot: Robot, config: RmpFlowConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, 6, (JointTarget.POSITION, JointTarget.VELOCITY))
        if config.range <= config.margin:
            raise ConfigurationError(
                f"action term '{name}': range is {config.range:g} m and margin {config.margin:g} m: give a range above "
                "the margin"
            )
        self.config = config
        """Settings, as the action term gives them."""
        self.frame = config.frame_of(robot)
        self._pose = config.pose_command(robot)
        self._tree = KinematicTree(robot.spec.articulation, self.device)
        self._home = robot.home_positions[joints]
        self._indices = torch.tensor(list(joints), dtype=torch.int64, device=self.device)
        self._chosen = torch.eye(len(robot.joint_names), device=self.device)[self._indices]
        upper = torch.triu_indices(len(joints), len(joints), device=self.device)
        self._upper = upper[0] * len(joints) + upper[1]
        places = torch.zeros(len(joints), len(joints), dtype=torch.int64, device=self.device)
        places[upper[0], upper[1]] = places[upper[1], upper[0]] = torch.arange(upper.shape[1], device=self.device)
        self._unpacked = places.flatten()
        self._unmoved = 1.0 - self._chosen.sum(0)
        # Position leads: rotation counts a quarter.
        self._weights = torch.tensor([1.0] * 3 + [0.25] * 3, device=self.device)
        self._reaches = torch.tensor([[config.goal_reach], [config.goal_turn]], device=self.device)
        speeds = joint_limits(robot.spec, "velocity_limit")[joints]
        self._fastest = torch.as_tensor(speeds, dtype=torch.float32, device=self.device)
        self._last = LastTargets(self.num_envs, (2, len(joints)), self.device)
        self._obstacle = Barrier(
            config.obstacle_weight, config.range, config.obstacle_speed, config.margin, config.obstacle_push
        )
        self._limit = Barrier(config.limit_weight, 0.2, 1.0, 0.02, 0.02)

    def enter(self, world: World, step_dt: float) -> None:
        obstacles = Obstacles(world, self.config.obstacles)
        self._clearance = Clearance(self.robot, self.joints, self._tree, obstacles)
        self._dt = step_dt / self.config.substeps
        self._alone, self._ahead = Fused(self._of_robot), Fused(self._step)
        self._off_obstacles = Fused(self._of_ball, in_parts=True)
        for gain in (self.config.goal_gain, self.config.posture_gain):
            if self._dt**2 * gain + 4.0 * self._dt * gain**0.5 >= 4.0:  # Jury's criterion, critically damped
                raise ConfigurationError(
                    f"action term '{self.name}': a gain of {gain:g} is unstable in steps of {self._dt:g} s: take at "
                    f"most {0.68 / self._dt**2:.3g}, or more substeps"
                )

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        goal = self._pose.target(inputs["command"])
        last = self._last.read(torch.stack((self.positions, self.velocities), 1))
        # Each in its own memory: a traced step passes both from one stage to the next.
        positions, velocities = (part.clone() for part in last.unbind(1))
        still = {"root": self.robot.root_pose, "others": self.robot.joint_positions, "goal": goal}
        obstacles = self._clearance.obstacles.poses()
        for _ in range(self.config.substeps):
            own, links, twists = self._alone(**still, positions=positions, velocities=velocities)
            around = self._around(links, twists, velocities, obstacles) if obstacles.shape[1] else torch.zeros_like(own)
            positions, velocities = self._ahead(own=own, around=around, positions=positions, velocities=velocities)
        measured = self.positions
        led = torch.clamp(positions, measured - self.config.max_lead, measured + self.config.max_lead)
        self._last.keep(torch.stack((led, velocities), 1))
        return {JointTarget.POSITION: led, JointTarget.VELOCITY: velocities}

    def _around(self, links: Tensor, twists: Tensor, velocities: Tensor, obstacles: Tensor) -> Tensor:
        """Metric and force of all balls together, as :meth:`_packed`."""
        clearance = self._clearance
        (each,) = self._off_obstacles(
            carrier=links.index_select(1, clearance.links), center=clearance.centers[None],
            radius=clearance.radii[None, :, None], moves=clearance.moves[None], counts=clearance.counts[None],
            origin=self.robot.root_pose[:, None, :3], twists=twists.unsqueeze(1), velocities=velocities.unsqueeze(1),
            obstacles=obstacles.unsqueeze(1),
        )  # fmt: skip
        return each.sum(1)

    def _packed(self, metric: Tensor, force: Tensor) -> Tensor:
        """Pack the upper triangle of a metric (..., k, k) and a force (..., k) into (..., k (k + 1) / 2 + k)."""
        return torch.cat((metric.flatten(-2)[..., self._upper], force), -1)

    def clearance(self) -> Tensor:
        """Return the distance (N,) in m from the robot's balls to the nearest obstacle, negative where they overlap."""
        gaps = self._clearance.gaps(self.robot.link_poses).flatten(1)
        return gaps.amin(1) if gaps.shape[1] else gaps.new_full((self.num_envs,), torch.inf)

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        pose = {f"pose_{key}": value for key, value in self._pose.memory().items()}
        return {**pose, **self._last.memory()}

    def _of_robot(
        self, root: Tensor, others: Tensor, goal: Tensor, positions: Tensor, velocities: Tensor
    ) -> tuple[Tensor, ...]:
        """Metric and force of goal, limits, posture and damping, :meth:`_packed`; links (N, L, 19) and twists.

        Of each link its pose, its twist and its spatial acceleration while no joint accelerates; the twists (N, k, 6)
        are those that joints give per unit of velocity. Twists are about the root's origin.
        """
        full = others * self._unmoved + positions @ self._chosen
        moving = velocities @ self._chosen
        links = self._tree.forward(root, full)
        spatial = self._tree.link_drifts(links, moving)
        parts = (
            self._towards_goal(links, velocities, goal, self._tree.frame_drift(links, moving, self.frame)),
            self._off_limits(positions, velocities),
        )
        metric, force = (one + other for one, other in zip(*parts, strict=True))
        twists = self._tree.motion_subspaces(links, root[:, :3]).index_select(1, self._indices)
        return self._packed(metric, force), torch.cat((links, *spatial), -1), twists

    def _step(self, own: Tensor, around: Tensor, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions and velocities (N, k) after a step of integration under two of :meth:`_packed`."""
        total, count = own + around, len(self.joints)
        metric, force = total[:, self._unpacked].unflatten(1, (count, count)), total[:, -count:]
        accelerations = solve_spd(metric, force.unsqueeze(-1)).squeeze(-1)
        velocities = velocities + self._dt * accelerations
        # All joints slowed down alike: the motion keeps the direction that keeps off obstacles.
        velocities = velocities * (self._fastest / velocities.abs().clamp_min(1e-9)).amin(1, True).clamp_max(1.0)
        ahead = torch.clamp(positions + self._dt * velocities, self.lower_limits, self.upper_limits)
        return ahead, (ahead - positions) / self._dt

    def _towards_goal(self, links: Tensor, velocities: Tensor, goal: Tensor, drift: Tensor) -> tuple[Tensor, Tensor]:
        """Metric (N, k, k) and force (N, k) of the goal."""
        jacobian = self._tree.jacobian(links, self.frame).index_select(2, self._indices)
        error = pose_error(self._tree.frame_pose(links, self.frame), goal)
        twist = torch.bmm(jacobian, velocities.unsqueeze(-1)).squeeze(-1)
        parts = error.unflatten(1, (2, 3))
        far = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
        bounded = (parts * (self._reaches / far.clamp_min(1e-9)).clamp_max(1.0)).flatten(1)
        wanted = self.config.goal_gain * bounded - 2.0 * self.config.goal_gain**0.5 * twist - drift
        weighted = jacobian.mT * self._weights
        return torch.bmm(weighted, jacobian), torch.bmm(weighted, wanted.unsqueeze(-1)).squeeze(-1)

    def _of_ball(
        self, carrier: Tensor, center: Tensor, radius: Tensor, moves: Tensor, counts: Tensor,
        origin: Tensor, twists: Tensor, velocities: Tensor, obstacles: Tensor,
    ) -> tuple[Tensor]:  # fmt: skip
        """Metric and force of one ball and all obstacles, :meth:`_packed`.

        Args:
            carrier: (..., 19) the ball's link, as :meth:`_of_robot` gives it.
            center: (..., 3) in the link.
            radius: (..., 1)
            moves: (..., k) 1 for joints that move the ball, else 0.
            counts: (..., O) 1 for obstacles that count for it, else 0.
            origin: (..., 3) of the root.
            twists: (..., k, 6)
            velocities: (..., k)
            obstacles: (..., O, 7)
        """
        point = carrier[..., :3] + quat_rotate(carrier[..., 3:7], center)
        arm = point - origin
        drift = drift_at(carrier[..., 7:13], carrier[..., 13:], arm)[..., :3]
        linear = twists[..., :3] + torch.linalg.cross(twists[..., 3:], arm.unsqueeze(-2))
        distances, away = self._clearance.obstacles.distances_of(obstacles, point)
        jacobian = away @ (linear * moves.unsqueeze(-1)).mT
        speed = (jacobian * velocities.unsqueeze(-2)).sum(-1)
        inertia, force = self._obstacle(distances - radius, speed)
        inertia, force = counts * inertia, counts * (force - inertia * (away * drift.unsqueeze(-2)).sum(-1))
        metric = jacobian.mT @ (jacobian * inertia.unsqueeze(-1))
        return (self._packed(metric, (jacobian * force.unsqueeze(-1)).sum(-2)),)

    def _off_limits(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Metric (N, k, k) and force (N, k) of limits, home and damping."""
        gain, weight = self.config.posture_gain, self.config.posture_weight
        home = gain * (self._home - positions) - 2.0 * gain**0.5 * velocities
        low, push_up = self._limit(positions - self.lower_limits, velocities)
        high, push_down = self._limit(self.upper_limits - positions, -velocities)
        return torch.diag_embed(weight + low + high), weight * home + push_up - push_down
