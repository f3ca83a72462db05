"""Gentle-Lift: lift a box of unknown weight, and grip it no tighter than it needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, cast

import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_core.actions import ActionTerm
from orbit_core.actions.joints import JointPosition, JointPositionConfig
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.envs import Environment, EventTerm, ObservationTerm, PremiseTerm, RewardTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, Meaning, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.mdp import common
from orbit_core.scene import ContactSensorSpec, PhysicsMaterial, RobotSpec, Scene
from orbit_core.sensors import ContactSensor
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import picking, tabletop, touch

# Metres of the box's edges.
SIZE = (0.05, 0.05, 0.1)
# Friction of box and fingers. The larger coefficient of a pair counts, and a Franka hand's fingers have 1.
FRICTION = 1.0
# Metres from the box's middle up to where it is held.
_HOLD = 0.01
_G = 9.81
_THING, _FINGERS = "thing", "fingers"


class GentleMemory(tabletop.TabletopMemory):
    """State of a box of unknown weight."""

    mass: Tensor = buffer()
    """(N,) kg of the box in this episode."""


@once_per_state
def thing_pose(env: Environment[GentleLift]) -> Tensor:
    """(N, 7) of the box in the environment's frame."""
    return env.world.objects[_THING].root_pose


@once_per_state
def hand_to_thing(env: Environment[GentleLift]) -> Tensor:
    """(N, 3) from the hand to where it holds the box."""
    return grasp(env)[:, :3] - common.hand_pose(env)[:, :3]


@once_per_state
def raised(env: Environment[GentleLift]) -> Tensor:
    """(N,) m, the height of the box's underside above the table."""
    return thing_pose(env)[:, 2] - 0.5 * SIZE[2]


@once_per_state
def grip_force(env: Environment[GentleLift]) -> Tensor:
    """(N,) newtons with which each finger presses on the box, the mean of the two."""
    sensor = cast(ContactSensor, env.world.sensors[_FINGERS])
    hand = common.hand_pose(env)[:, None, 3:]
    # Fingers of a parallel gripper press along the hand's y axis.
    return quat_rotate_inverse(hand, sensor.filtered_forces[:, :, 0])[..., 1].abs().mean(1)


@once_per_state
def grip_ratio(env: Environment[GentleLift, GentleMemory]) -> Tensor:
    """(N,) the grip over the least that bears the box's weight by the friction of both fingers."""
    return grip_force(env) * (2.0 * FRICTION / _G) / env.state.mass.clamp_min(1e-6)


def mass(env: Environment[GentleLift, GentleMemory]) -> Tensor:
    """(N, 1) kg of the box, which the policy does not know."""
    return env.state.mass[:, None]


def grasp(env: Environment[GentleLift]) -> Tensor:
    """(N, 7) the hand around the upper part of the box."""
    pose = thing_pose(env).clone()
    pose[:, 2] += _HOLD
    return picking.grasp_square(pose)


def reaching(env: Environment[GentleLift]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to where it holds the box."""
    return common.nearness(hand_to_thing(env).norm(dim=1), 0.1)


def lifting(env: Environment[GentleLift]) -> Tensor:
    """(N,) in [0, 1]: how far the box is up."""
    return (raised(env) / env.task.height).clamp(0.0, 1.0)


def gentle(env: Environment[GentleLift]) -> Tensor:
    """(N,) in [0, 1]: how little more than needed a box off the table is gripped; 1 up to half of what is allowed."""
    excess = (grip_ratio(env) - 0.5 * (1.0 + env.task.most_grip)).clamp_min(0.0)
    return (raised(env) > 0.005) * common.nearness(excess, 1.0)


def place_thing(env: Environment[GentleLift, GentleMemory], env_ids: Tensor) -> None:
    """Stand the box in the middle of the workspace, within 10 x 20 cm, turned by any angle, and draw its mass."""
    low, high = common.workspace(env.world)
    x, y, (light, heavy) = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), env.task.masses
    bounds = (
        (x - 0.05, y - 0.1, 0.5 * SIZE[2], -math.pi, light),
        (x + 0.05, y + 0.1, 0.5 * SIZE[2], math.pi, heavy),
    )
    drawn = env.world.random.uniform((5,), *bounds, env_ids)
    thing = env.world.objects[_THING]
    thing.set_root_pose(common.standing(drawn[:, :4]), env_ids)
    thing.set_masses(drawn[:, 4:], env_ids=env_ids)
    env.state.mass[env_ids] = drawn[:, 4]


@dataclass
class GentleSensed(tabletop.GraspState):
    """The arm's joints, the hand, the box's pose, the taxels of both pads and the last action."""

    thing_pose: ObservationTerm | None = ObservationTerm(thing_pose, unit=POSE)
    hand_to_thing: ObservationTerm | None = ObservationTerm(hand_to_thing, unit="m")
    first_pad: ObservationTerm | None = None
    """Forces on the taxels of one finger; given by the task where it has touch."""
    second_pad: ObservationTerm | None = None
    """The same of the other finger."""
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class GentleState(tabletop.GraspState):
    """The arm's joints, the hand, the box's pose and mass, the grip and the last action."""

    thing_pose: ObservationTerm | None = ObservationTerm(thing_pose, unit=POSE)
    hand_to_thing: ObservationTerm | None = ObservationTerm(hand_to_thing, unit="m")
    mass: ObservationTerm | None = ObservationTerm(mass, unit="kg")
    grip: ObservationTerm | None = ObservationTerm(
        lambda env: grip_force(env)[:, None], unit="N", meaning=Meaning("force with which each finger presses")
    )
    """Newtons with which each finger presses."""
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class GentleRewards:
    """Rewards of the hand at the box, the box up, and a grip no tighter than needed."""

    reach: RewardTerm | None = RewardTerm(reaching, 0.5)
    lift: RewardTerm | None = RewardTerm(lifting, 5.0)
    gentle: RewardTerm | None = RewardTerm(gentle, 5.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class GentleEvents(tabletop.ArmEvents):
    """Robot and box are placed for each episode, and the box's mass is drawn."""

    place_thing: EventTerm | None = EventTerm(place_thing)


@dataclass
class GentlePremises:
    """The box stands free on the table."""

    standing: PremiseTerm | None = tabletop.pieces_stand(0.5 * SIZE[2])


@dataclass(kw_only=True)
class GentleLift(tabletop.TabletopTask):
    """A box, whose mass differs between episodes and is not observed, is lifted by a grip that the action sets.

    The last component of the action is the position that the fingers are sent to, from closed at -1 to open at 0 and
    above: the farther it is within the box, the harder they press. Succeeds when the box is ``height`` above the table
    at the episode's end, within ``tolerance``, and each finger presses with no more than ``most_grip`` times what
    friction needs to bear the weight. Metric: that ratio.
    """

    state_type: ClassVar[type[TaskState]] = GentleMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="lift the box without squeezing it",
        ppo=PpoSettings(iterations=1500, initial_std=0.3, entropy_weight=0.002),
        exceptions=(TaskException(TaskCheck.START_AREA, "the box starts within 10 x 20 cm: its weight differs"),),
    )
    episode_length: float = 12.0
    masses: tuple[float, float] = (0.15, 1.0)
    """Range of the box's mass, kg."""
    height: float = 0.1
    """Metres by which the box is to be lifted."""
    tolerance: float = 0.02
    """Metres."""
    most_grip: float = 2.0
    """Grip that is allowed, over the least that bears the box."""
    touch: bool = True
    """False takes the pads away, for comparison: the expert then grips as a box of the range's middle needs."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.sensed(GentleSensed, GentleState))
    rewards: GentleRewards = field(default_factory=GentleRewards)
    terminations: tabletop.DropTerminations = field(default_factory=tabletop.DropTerminations)
    events: GentleEvents = field(default_factory=GentleEvents)
    premises: GentlePremises = field(default_factory=GentlePremises)

    @property
    def pieces(self) -> tuple[str, ...]:
        return (_THING,)

    def preset_terms(self, spec: RobotSpec, prefix: str) -> dict[str, ActionTerm]:
        terms = super().preset_terms(spec, prefix)
        gripper = spec.end_effector.gripper
        name = f"{prefix}gripper"
        if gripper is None or name not in terms:
            raise ConfigurationError(
                f"robot '{spec.name}' has no gripper apart from action '{self.action}': choose franka_panda"
            )
        # In place of open or closed: a position in between, whose distance within the box sets the force.
        return terms | {name: JointPositionConfig(robot=spec.name, joints=gripper.joints, scale=None)}

    def scene(self) -> Scene:
        self.bound(height=(0.02, 0.2), tolerance=(1e-3, 0.1), most_grip=(1.0, 100.0))
        if not 0.02 <= self.masses[0] <= self.masses[1] <= 2.0:
            raise ConfigurationError(
                f"field 'masses' of task GentleLift is {self.masses}: give a range within 0.02 to 2 kg, the lower first"
            )
        middle = sum(self.masses) / 2.0
        thing = box(
            _THING, SIZE, mass=middle, material=PhysicsMaterial(FRICTION, FRICTION), color=(0.85, 0.6, 0.15, 1.0)
        )
        scene = self.bench(thing)
        robot = scene.robots[0]
        pads = touch.finger_pads(robot, size=(0.016, 0.018), taxels=(6, 6), friction=FRICTION).specs
        fingers = tuple(pad.links[0] for pad in pads)
        grip = ContactSensorSpec(name=_FINGERS, entity=robot.name, links=fingers, filters=(_THING,))
        sensors = (*scene.sensors, grip)
        if self.touch:
            sensors = (*sensors, *pads)
            policy = self.observations.policy
            if isinstance(policy, GentleSensed):
                policy.first_pad, policy.second_pad = (touch.taxels(index, pad) for index, pad in enumerate(pads))
        return replace(scene, sensors=sensors)

    def randomize(self) -> None:
        """The arm's gains, and noise on joints and box. Friction stays: the least grip follows from it."""
        self.vary((_THING,), (FRICTION, FRICTION), thing_pose=0.001, hand_to_thing=0.001)

    def success(self, env: Environment) -> Tensor:
        return ((raised(env) - self.height).abs() < self.tolerance) & (grip_ratio(env) <= self.most_grip)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"grip_ratio": grip_ratio(env), "raised_m": raised(env)}

    def expert(self, env: Environment) -> Expert:
        return GentleExpert(env)


# Share of the greatest shear, by friction, above which a taxel is about to slip.
_NEAR_SLIP = 0.75
# Share of loaded taxels that are about to slip, above which the grip is raised.
_SLIPPING = 0.3
# Newtons on each pad at which the fingers have closed on the box.
_CONTACT = 0.3
# m/s at which the position that fingers are sent to moves in while they close: their drives are 0.05 s late, so that
# they press by half a newton when contact is felt. Before, they are sent to some millimetres from the box.
_CLOSING, _NEAR = 0.01, 0.004
# 1/s at which the grip grows while the box slips, in proportion to itself: late drives overshoot by a third.
_TIGHTENING = 4.0
# How many times what a box of the middle mass needs an expert without touch grips with.
_BLIND = 1.4
# Metres by which the hand is led up while the box is still on the table or just off it, and then. The drives hold a
# kilogram with an error of 4 mm.
_SLOW, _FAST = 0.008, 0.015
# Number of the phase in which the fingers close.
_CLOSE = 2


class GentleExpert(Expert):
    """Expert that closes the fingers until they touch, lifts, and tightens the grip where taxels are about to slip."""

    def __init__(self, env: Environment[GentleLift]) -> None:
        self._task_env = env
        robot = env.world.robots[common.ROBOT]
        gripper = robot.spec.end_effector.gripper
        assert gripper is not None  # the task's action refuses a robot without
        opened = gripper_positions(robot.spec, gripper, gripper.open_position)
        joints = robot.find_joints(*gripper.joints)
        self._open = torch.tensor([opened[joint] for joint in joints], device=env.device)
        # Metres that the fingers are sent to.
        self._sent = self._open.repeat(env.num_envs, 1)
        # Where the box slips the hand waits until the grip has grown.
        self._slips = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
        self._generator = next(
            each for each in env.actions.generators if isinstance(each, JointPosition) and [*each.joints] == [*joints]
        )
        # Two fingers share the force of one drive.
        self._share = 0.5 * robot.nominal_gains[joints[0]][0]
        needed = _BLIND * _G * sum(env.task.masses) / 2.0 / (2.0 * FRICTION)
        self._blind = 0.5 * SIZE[1] - needed / self._share
        closing = 1.2
        phases = (
            Phase(picking.raised(grasp, 0.1), position_tolerance=0.02, free=True),
            Phase(grasp, position_tolerance=0.004, timeout=2.0),
            Phase(common.hand_pose, dwell=closing, timeout=closing + 0.1),
            Phase(self._up),
        )
        super().__init__(env, phases, 0.06)

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        rows = slice(None) if env_ids is None else env_ids
        self._sent[rows] = self._open
        self._slips[rows] = False

    def memory(self) -> Mapping[str, Tensor]:
        return {**super().memory(), "sent": self._sent, "slips": self._slips}

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        env, speed = self._task_env, self._speed(self._task_env)
        action = super().compute(inputs)["action"]
        near = self._sent.clamp(max=0.5 * SIZE[1] + _NEAR)
        self._sent.copy_(torch.where((self.phase == _CLOSE)[:, None], near, self._sent))
        self._sent -= (env.step_dt * speed)[:, None]
        fingers = self._generator.encode_positions(self._sent)
        return {"action": torch.cat((action[:, : -fingers.shape[1]], fingers), dim=1)}

    def _speed(self, env: Environment[GentleLift]) -> Tensor:
        """(N,) m/s at which the fingers' targets move in now."""
        if not env.task.touch:
            return torch.where((self.phase >= _CLOSE) & (self._sent[:, 0] > self._blind), _CLOSING, 0.0)
        grip, apart, slips = touched(env)
        self._slips.copy_(slips & (self.phase > _CLOSE))
        tighten = torch.where(self._slips, _TIGHTENING * grip.clamp_min(_CONTACT) / self._share, 0.0)
        return torch.where((self.phase == _CLOSE) & apart, _CLOSING, tighten)

    def _up(self, env: Environment[GentleLift]) -> Tensor:
        """(N, 7) the hand a little higher, until the box is up; half as fast while the box slips."""
        hand, lead = common.hand_pose(env), torch.where(raised(env) < 0.01, _SLOW, _FAST)
        left = (env.task.height - raised(env)).minimum(lead).maximum(-lead)
        # Half of the way bears the weight that the arm has taken up.
        left = torch.where(self._slips, 0.5 * left, left)
        return torch.cat((hand[:, :2], (hand[:, 2] + left)[:, None], hand[:, 3:]), dim=1)


def touched(env: Environment[GentleLift]) -> tuple[Tensor, Tensor, Tensor]:
    """Return what the pads feel: (N,) newtons on each, the mean of both; and (N,) bool whether one is apart from the
    box, and whether the box is about to slip on both.
    """
    felt = [
        (pad.normal_forces.flatten(1), pad.shear_forces.norm(dim=-1).flatten(1)) for pad in touch.sensors(env.world)
    ]
    normal, shear = (torch.stack(each, dim=1) for each in zip(*felt, strict=True))
    pressing = normal.sum(2)
    # The mean of both pads: how rigid bodies share a weight between two pads is not determined, and an engine may hang
    # all of it on one; the box slips only where both are at their limit.
    normal, shear = normal.mean(1), shear.mean(1)
    loaded = normal > 1e-3
    near = loaded & (shear > _NEAR_SLIP * FRICTION * normal)
    slips = near.sum(1) > _SLIPPING * loaded.sum(1)
    return pressing.mean(1), (pressing < _CONTACT).any(1), slips
