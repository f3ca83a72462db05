"""A trot that follows commands: footholds after Raibert, legs by inverse kinematics, forces that carry and correct.

Diagonal feet step together. A swinging foot is put down where the trunk will be half a stance later, and farther by
how much faster it goes than it should (Raibert, Legged Robots That Balance, 1986); a foot on the ground is drawn back
under the trunk at the commanded velocity. The legs' drives are soft: their targets lie beyond the wanted positions by
what the forces that the feet shall exert deflect them, and by what their damping takes from a joint that moves. Few
engines keep a joint to its velocity limit, so the gait does: the targets of a leg in the air run ahead of its joints
by no more than takes them to the limit. A foot that ought to stand but has not met the ground yet is in the air too:
given the weight to carry, its knee turned at three times the limit.

The trunk turns to and fro once a stride, by whichever pair stands. What takes that back is learned in the first
strides: a moment of the stride's period, whose sine and cosine grow with the error of the yaw rate that is in step with
them (Bodson, Sacks and Khosla, Harmonic Generation in Adaptive Feedforward Cancellation Schemes, 1994).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.actions import JointPosition
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs import Environment
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_core.interfaces.layout import joint_limits
from orbit_core.mdp import common
from orbit_tasks import biped, walking

# m^2: of the inverse kinematics; keeps steps bounded at a straight knee (Nakamura and Hanafusa, 1986).
_DAMPING = 1e-4
_NEWTON_STEPS = 2
# Part of a joint's velocity limit that its wanted position may move at.
_OWN_SPEED = 0.9
# N: force above which a foot is on the ground.
_TOUCH = 1.0


@dataclass(frozen=True)
class Gait:
    """Timing, size and gains of the steps."""

    period: float = 0.2
    """Seconds for a step of each foot."""
    stance: float = 0.56
    """Part of the period that a foot is on the ground."""
    onset: float = 0.1
    """Part of the period over which a foot that lands takes its load over from those that stand."""
    swing_height: float = 0.05
    """Metres."""
    ease: float = 1.0
    """How softly a swing begins and ends: its greatest speed is ``1 + ease`` times the mean one."""
    rise: float = 0.03
    """Part of its height over the feet at home by which the trunk goes higher: straighter knees carry more."""
    foothold_gain: float = 0.05
    """s: how much farther a foot is put for each m/s that the trunk goes faster than wanted."""
    velocity_gain: float = 10.0
    """1/s: horizontal acceleration that the feet on the ground are asked for, over the error of the velocity."""
    turning_gain: float = 15.0
    """1/s: angular acceleration about the vertical over the error of the yaw rate."""
    grip: float = 0.3
    """Largest part of what a foot carries that it pushes along the ground with."""
    integral_gain: float = 1.0
    """1/s, of the errors of velocity and yaw rate: what slips and gives way takes part of each stride."""
    integral_limit: float = 0.4
    """m/s and rad/s."""
    smoothing: float = 0.06
    """Seconds over which the measured velocity is averaged."""
    ramp: float = 1.5
    """m/s^2 and rad/s^2 at which the wanted velocity goes to the commanded one."""
    top_speed: float = math.inf
    """m/s over the ground of the trunk's point above its fastest foot; a faster command is followed in part."""
    sway_gain: float = 30.0
    """1/s^2: how fast the moment against the trunk's sway grows with the sway."""
    sway_limit: float = 20.0
    """rad/s^2: most of that moment, over the inertia."""
    height_gain: float = 40.0
    """1/s^2: vertical acceleration over the error of the trunk's height."""


# For legs whose joints turn too slowly for the usual steps: bent knees lift a foot by less of a turn, and what swings
# lack, forces along the ground make up for. The more of these the sway takes, the less is left for the velocity.
SLOW_JOINTS = Gait(
    period=0.24, stance=0.62, swing_height=0.03, ease=0.3, rise=-0.13, foothold_gain=0.1, velocity_gain=20.0,
    turning_gain=20.0, grip=0.5, top_speed=1.0, sway_gain=10.0,
)  # fmt: skip
# m/s: speed at which a gait's swings are held against the joints' velocity limits.
_BRISK = 1.0


class FootholdGait(Node):
    """Gives the action whose joint targets walk a quadruped at commanded velocities.

    Args:
        env: of a quadruped on level ground, with the contact sensor :data:`orbit_tasks.biped.CONTACTS`; its actions are
            joint positions.
        command: (N, 3) forward and sideways velocity in m/s and yaw rate in rad/s, in the trunk's axes; read at each
            turn.
        gait: timing, size and gains of the steps; None: the usual ones, or :data:`SLOW_JOINTS` where these would take a
            joint to its velocity limit.

    Raises:
        ConfigurationError: the actions are others, or the robot has not four feet.
    """

    def __init__(self, env: Environment, command: Tensor, gait: Gait | None = None) -> None:
        self.name = "policy"
        """Name of the node in the agent's graph, where it takes the policy's place."""
        generator = env.actions.generators[0]
        if not isinstance(generator, JointPosition):
            raise ConfigurationError(f"a gait gives joint positions: action '{env.task.action}' does not take them")
        robot = common.robot_of(env.world)
        self._feet = robot.spec.feet
        if len(self._feet) != 4:
            raise ConfigurationError(f"a gait needs a robot with four feet; '{env.task.robot}' has {len(self._feet)}")
        self._generator, self._task, self._command, self._robot = generator, env.task, command, robot
        self._state = env.state
        self.outputs = (Port("action", (generator.command_size,)),)
        """Port of the action, whose numbers are joint targets as the action space takes them."""
        self._dt = env.step_dt
        self._gravity = -env.world.scene.gravity[2]
        self._tree = KinematicTree(robot.spec.articulation, env.device)
        self._legs = self._columns_of_legs()
        count = env.num_envs
        root = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], device=env.device)
        self._root = root.expand(count, 7)
        # (N, J) that the legs shall have.
        self._positions = robot.home_positions.repeat(count, 1)
        limits = torch.as_tensor(joint_limits(robot.spec, "velocity_limit"), dtype=torch.float32, device=env.device)
        feet, jacobian = self._kinematics(self._positions[:1], self._root[:1])
        usual = Gait()
        hasty = _swing_speed(usual, jacobian[0]) > limits[self._legs]
        self._gait = gait or (SLOW_JOINTS if bool(hasty.any()) else usual)
        # (1, 4, 3) feet in the trunk's frame at home.
        self._neutral = feet * torch.tensor([1.0, 1.0, 1.0 + self._gait.rise], device=env.device)
        # (N, 4, 3) wanted of the feet, in the level frame of the trunk: where they are, or lifted off.
        self._planted = self._neutral.repeat(count, 1, 1)
        self._velocities = torch.zeros(3, count, 3, device=env.device)
        # (N, 3) each: integrated error, what was measured, smoothed, and what is wanted on the way to the command.
        self._integral, self._smooth, self._asked = self._velocities.unbind()
        # (N,) each: rad/s^2 of the stride's cosine and sine.
        self._against_sway = torch.zeros(2, count, device=env.device)
        # Feet on opposite corners of the trunk step together.
        self._offset = 0.5 * (self._neutral[0, :, 0] * self._neutral[0, :, 1] > 0).float()
        gains = robot.nominal_gains
        self._stiffness = torch.tensor([gains[j][0] for j in range(len(gains))], device=env.device)
        self._lag = torch.tensor([gains[j][1] / gains[j][0] for j in range(len(gains))], device=env.device)
        self._most_turn = _OWN_SPEED * limits * self._dt
        # A free joint approaches a held target with the drive's time constant, `_lag`: this far ahead it turns at its
        # limit on average over a control step.
        self._reach = limits * self._dt / -torch.expm1(-self._dt / self._lag)
        self._contacts = biped.contacts_of(env.world)
        links = list(self._contacts.link_names)
        touching = [links.index(robot.spec.articulation.frame(foot).link) for foot in self._feet]
        self._foot_links = torch.tensor(touching, device=env.device)
        self._mass = robot.spec.articulation.mass
        # kg m^2 about the vertical, of the mass as if it lay over the feet.
        self._inertia = self._mass * float(self._neutral[..., :2].square().sum(2).mean())
        self._height = robot.spec.pose.position[2]

    def memory(self) -> Mapping[str, Tensor]:
        velocities = {"integral": self._integral, "smooth": self._smooth, "asked": self._asked}
        return {
            "positions": self._positions, "planted": self._planted, "against_sway": self._against_sway, **velocities
        }  # fmt: skip

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._positions[rows] = self._robot.home_positions
        self._planted[rows] = self._neutral
        self._velocities[:, rows] = 0.0
        self._against_sway[:, rows] = 0.0

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self._begin(self._state.episode_step == 0)
        gait = self._gait
        tilt = self._tilt()
        self._smooth.lerp_(self._velocity(), min(self._dt / gait.smoothing, 1.0))
        self._asked.add_(
            (self._reachable(self._command) - self._asked).clamp(-gait.ramp * self._dt, gait.ramp * self._dt)
        )
        velocity, error = self._smooth, self._asked - self._smooth
        self._integral.add_(error, alpha=gait.integral_gain * self._dt).clamp_(
            -gait.integral_limit, gait.integral_limit
        )
        wanted = self._asked + self._integral
        phase, standing = self._phase(self._state.episode_step)
        landing = self._phase(self._state.episode_step + 1)[1] & ~standing
        feet = self._feet_wanted(phase, standing, landing, wanted, velocity, tilt)
        before = self._positions.clone()
        jacobian = self._solve(feet)
        turned = (self._positions - before).clamp(-self._most_turn, self._most_turn)
        self._positions.copy_(before + turned)
        forces = self._forces(phase, standing, error)
        efforts = -(jacobian.transpose(2, 3) @ forces[..., None]).squeeze(-1)  # (N, 4, 3)
        pressed = torch.zeros_like(before)
        pressed[:, self._legs.flatten()] = efforts.flatten(1)
        targets = self._positions + self._lag * turned / self._dt + pressed / self._stiffness
        targets = self._within_speed(targets, standing)
        return {"action": self._generator.encode_positions(targets[:, self._generator.joints])}

    def _begin(self, new: Tensor) -> None:
        """Forget the past of the environments (N,) bool whose episodes begin."""
        self._positions.copy_(torch.where(new[:, None], self._robot.home_positions, self._positions))
        self._planted.copy_(torch.where(new[:, None, None], self._neutral, self._planted))
        self._velocities.masked_fill_(new[None, :, None], 0.0)
        self._against_sway.masked_fill_(new, 0.0)

    def _phase(self, step: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 4) part of its period that each foot has had at steps (N,), and whether it is then on the ground."""
        phase = torch.remainder(step[:, None] * (self._dt / self._gait.period) + self._offset, 1.0)
        return phase, phase < self._gait.stance

    def _feet_wanted(
        self, phase: Tensor, standing: Tensor, landing: Tensor, wanted: Tensor, velocity: Tensor, tilt: Tensor
    ) -> Tensor:
        """(N, 4, 3) in the trunk's frame; moves the planted feet on."""
        gait = self._gait
        past = ((phase - gait.stance) / (1.0 - gait.stance)).clamp(0.0, 1.0)
        self._planted[..., :2] -= standing[..., None] * self._dt * self._carried(wanted, self._planted)
        half = 0.5 * gait.stance * gait.period
        surplus = gait.foothold_gain * (velocity[:, :2] - self._asked[:, :2])
        ahead = self._neutral[..., :2] + half * self._carried(wanted, self._neutral) + surplus[:, None]
        share = past - gait.ease * torch.sin(2.0 * torch.pi * past) / (2.0 * torch.pi)
        swinging = self._planted[..., :2] + share[..., None] * (ahead - self._planted[..., :2])
        self._planted[..., :2] = torch.where(landing[..., None], ahead, self._planted[..., :2])
        height = self._neutral[..., 2] + gait.swing_height * torch.sin(torch.pi * past).square() * ~standing
        flat = torch.where(standing[..., None], self._planted[..., :2], swinging)
        feet = torch.cat((flat, height[..., None]), 2)
        # A foot in the air keeps clear of the ground at any tilt of the trunk; feet on it hold the trunk by theirs.
        roll, pitch = tilt[:, None, 0], tilt[:, None, 1]
        lean = pitch * feet[..., 0] - roll * feet[..., 1]
        return torch.cat((flat, (height + lean * ~standing)[..., None]), 2)

    def _reachable(self, command: Tensor) -> Tensor:
        """Return commands (N, 3), scaled down where a foot would have to follow faster than ``top_speed``."""
        fastest = self._carried(command, self._neutral.expand(len(command), 4, 3)).norm(dim=2).amax(1)
        return command * (self._gait.top_speed / fastest.clamp_min(1e-6)).clamp_max(1.0)[:, None]

    def _within_speed(self, targets: Tensor, standing: Tensor) -> Tensor:
        """Clamp joint targets (N, J) of legs in the air to what keeps their joints within the velocity limits.

        A foot is in the air where it swings, ``standing`` (N, 4) is False, or has not met the ground yet.
        """
        touching = self._contacts.forces[:, self._foot_links].square().sum(2) > _TOUCH**2
        air = torch.zeros_like(targets, dtype=torch.bool)
        air[:, self._legs.flatten()] = ~(standing & touching).repeat_interleave(3, dim=1)
        at = self._robot.joint_positions
        return torch.where(air, targets.clamp(at - self._reach, at + self._reach), targets)

    def _carried(self, motion: Tensor, feet: Tensor) -> Tensor:
        """(N, 4, 2) velocity of the trunk's points above feet (N, 4, 3), for planar motion (N, 3)."""
        turn = torch.stack((-feet[..., 1], feet[..., 0]), dim=2) * motion[:, None, 2:]
        return motion[:, None, :2] + turn

    def _forces(self, phase: Tensor, standing: Tensor, error: Tensor) -> Tensor:
        """(N, 4, 3) N that the ground shall exert on the feet: the robot's weight, and what corrects its motion."""
        gait = self._gait
        standing = standing.float()
        load = standing * ((phase + 0.5 * self._dt / gait.period) / gait.onset).clamp_max(1.0)
        share = load / load.sum(1, keepdim=True).clamp_min(1e-3)
        low = self._height - self._robot.root_pose[:, 2]
        vertical = share * (self._mass * (self._gravity + gait.height_gain * low)).clamp_min(0.0)[:, None]
        along = share[..., None] * (self._mass * gait.velocity_gain * error[:, None, :2])
        arms = torch.stack((-self._planted[..., 1], self._planted[..., 0]), 2) * standing[..., None]
        leverage = arms.square().sum((1, 2)).clamp_min(1e-3)
        moment = self._inertia * (gait.turning_gain * error[:, 2] + self._unswaying())
        along = along + arms * (moment / leverage)[:, None, None]
        most = gait.grip * vertical / along.norm(dim=2).clamp_min(1e-6)
        return torch.cat((along * most.clamp_max(1.0)[..., None], vertical[..., None]), 2)

    def _unswaying(self) -> Tensor:
        """(N,) rad/s^2 about the vertical against the trunk's sway; learns from how it sways now."""
        gait = self._gait
        error = self._asked[:, 2] - walking.angular_velocity(self._robot)[:, 2]
        stride = (2.0 * torch.pi / gait.period) * self._dt * self._state.episode_step
        cosine, sine = torch.cos(stride), torch.sin(stride)
        # A yaw rate lags a quarter behind its moment.
        learned = torch.stack((sine, -cosine)) * (gait.sway_gain * self._dt * error)
        self._against_sway.add_(learned).clamp_(-gait.sway_limit, gait.sway_limit)
        return self._against_sway[0] * cosine + self._against_sway[1] * sine

    def _solve(self, feet: Tensor) -> Tensor:
        """Move the wanted positions so that feet are where they are wanted; gives the legs' Jacobians (N, 4, 3, 3)."""
        at, jacobian = self._kinematics(self._positions, self._root)
        for _ in range(_NEWTON_STEPS):
            square = jacobian @ jacobian.transpose(2, 3)
            square = square + _DAMPING * torch.eye(3, device=square.device)
            step = jacobian.transpose(2, 3) @ torch.linalg.solve(square, (feet - at)[..., None])
            self._positions[:, self._legs.flatten()] += step.squeeze(-1).flatten(1)
            at, jacobian = self._kinematics(self._positions, self._root)
        return jacobian

    def _kinematics(self, positions: Tensor, root: Tensor) -> tuple[Tensor, Tensor]:
        """Feet (N, 4, 3) in the trunk's frame, and their Jacobians by their own legs' joints (N, 4, 3, 3)."""
        poses = self._tree.forward(root, positions)
        feet = torch.stack([self._tree.frame_pose(poses, foot)[:, :3] for foot in self._feet], 1)
        whole = torch.stack([self._tree.jacobian(poses, foot)[:, :3] for foot in self._feet], 1)
        columns = self._legs[None, :, None, :].expand(len(positions), 4, 3, 3)
        return feet, whole.gather(3, columns)

    def _columns_of_legs(self) -> Tensor:
        """(4, 3) int64: the joints on the way to each foot."""
        home, device = self._robot.home_positions, self._robot.home_positions.device
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=device)
        poses = self._tree.forward(root, home.view(1, -1))
        moved = torch.stack([self._tree.jacobian(poses, foot)[0, 3:].norm(dim=0) > 0.5 for foot in self._feet])
        if moved.sum(1).tolist() != [3, 3, 3, 3]:
            raise ConfigurationError(
                f"a gait needs legs of three joints; those of '{self._task.robot}' have {moved.sum(1).tolist()}"
            )
        return moved.nonzero()[:, 1].view(4, 3)

    def _tilt(self) -> Tensor:
        """(N, 2) roll and pitch, rad, small ones."""
        up = -walking.projected_gravity(self._robot)
        return torch.stack((torch.atan2(up[:, 1], up[:, 2]), torch.atan2(-up[:, 0], up[:, 2])), 1)

    def _velocity(self) -> Tensor:
        """(N, 3) m/s forward and to the left, rad/s about the vertical."""
        linear, turning = walking.linear_velocity(self._robot), walking.angular_velocity(self._robot)
        return torch.cat((linear[:, :2], turning[:, 2:]), 1)


def _swing_speed(gait: Gait, jacobian: Tensor) -> Tensor:
    """(4, 3) rad/s: most that joints turn at in swings at :data:`_BRISK`, by the legs' Jacobians (4, 3, 3) at home."""
    swing = (1.0 - gait.stance) * gait.period
    along = _BRISK * gait.stance / (1.0 - gait.stance)
    upward = math.pi * gait.swing_height / swing  # of a squared sine, at a quarter and three of the swing
    feet = torch.tensor(
        [[along, along, (1.0 + gait.ease) * along], [0.0, 0.0, 0.0], [upward, -upward, 0.0]], device=jacobian.device
    )
    return torch.linalg.solve(jacobian, feet.expand(4, 3, 3)).abs().amax(2)
