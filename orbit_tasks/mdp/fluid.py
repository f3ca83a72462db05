"""A cup of liquid with a handle, for tasks that carry it and pour from it: its scene, terms and grasp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.deformables import open_box
from orbit_assets.objects import BENCH_HEIGHT, SolidOptions, box, box_between, solid_part, work_bench
from orbit_core.dynamics.transforms import quat_multiply, quat_rotate
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import EventFunction, Meaning, TermFunction, measured_in, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import (
    Articulation,
    Fluid,
    MarkerSpec,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Region,
    Scene,
)
from orbit_core.scene.pose import Vector3
from orbit_motion.experts import Phase
from orbit_motion.workspace import arm
from orbit_tasks.mdp import matter, picking, stages

LIQUID, CUP, STAND = "liquid", "cup", "stand"
INNER: Vector3 = (0.06, 0.06, 0.08)
"""Metres within the cup."""
FILLED = 0.06
"""Metres of liquid in the cup."""
WALL = 0.004
HANDLE: Vector3 = (0.036, 0.038, 0.05)
"""Metres of the bar that a gripper takes the cup by; every gripper of the catalogue opens wider."""
GRIP: Vector3 = (-0.5 * INNER[0] - WALL - 0.016, 0.0, 0.058)
"""Middle of a grasp in the cup's frame: so near the cup that its weight turns it little about the fingers, and so high
that palms are above the rim."""
RAISED = 0.1
"""Metres of the stand."""
HELD = (0.4, 0.53)
"""Least and greatest opening of a gripper that holds the handle: of a Panda's hand it takes 0.48. Fingers that strike
it sink in to 0.1 where contacts yield, and have come out to 0.46 after 0.1 s."""
FIRM = PhysicsMaterial(static_friction=1.0, dynamic_friction=1.0)
SLOW = 0.05
"""Metres that a carrying hand is led ahead: the liquid stays calm."""


# Scene ---------------------------------------------------------------------------------------------------------------


def cup(pose: Pose, density: float = 1000.0) -> ObjectSpec:
    """Build a cup with a square base, its frame in the middle of the floor within, and its handle towards -x."""
    x, y, z = 0.5 * INNER[0], 0.5 * INNER[1], INNER[2]
    color = (0.85, 0.85, 0.88, 0.5)
    corners = {
        "floor": ((-x - WALL, -y - WALL, -WALL), (x + WALL, y + WALL, 0.0)),
        "left": ((-x - WALL, y, 0.0), (x + WALL, y + WALL, z)),
        "right": ((-x - WALL, -y - WALL, 0.0), (x + WALL, -y, z)),
        "front": ((x, -y, 0.0), (x + WALL, y, z)),
        "back": ((-x - WALL, -y, 0.0), (-x, y, z)),
        "handle": (
            (-x - WALL - HANDLE[0], -0.5 * HANDLE[1], GRIP[2] - 0.5 * HANDLE[2]),
            (-x - WALL, 0.5 * HANDLE[1], GRIP[2] + 0.5 * HANDLE[2]),
        ),
    }
    shapes = tuple(box_between(name, *ends, color, FIRM) for name, ends in corners.items())
    link = solid_part(CUP, shapes, density, CUP)
    return ObjectSpec(name=CUP, articulation=Articulation(CUP, (link,)), pose=pose, semantic_label=CUP)


def region_of(name: str, inner: Vector3) -> Region:
    """Return the inside of a container whose frame is in the middle of its floor, and 1 cm more at its rim."""
    x, y, z = inner
    # The walls count as inside: particles that lean on them press a little into them.
    half = (0.5 * x + WALL, 0.5 * y + WALL, 0.5 * z + 0.005)
    return Region(half, Pose((0.0, 0.0, 0.5 * z + 0.005)), name, name)


def container(name: str, inner: Vector3, place: tuple[float, float]) -> ObjectSpec:
    """Build a fixed container on the table, open at the top."""
    return open_box(name, inner, Pose((*place, 0.01)))


# Terms ---------------------------------------------------------------------------------------------------------------


def amount_in(name: str, inner: Vector3) -> TermFunction:
    """Term: (N,) in [0, 1], the part of the liquid that is in a container of that inside."""
    region = region_of(name, inner)

    @once_per_state
    def observe(env: Environment) -> Tensor:
        """Return (N,) in [0, 1], the part of the liquid that is inside."""
        return env.world.deformables[LIQUID].share_inside(region)

    return observe


in_cup = amount_in(CUP, INNER)
"""(N,) in [0, 1], the part of the liquid that is in the cup."""


def spilt(amounts: Sequence[TermFunction]) -> TermFunction:
    """Term: (N,) in [0, 1], the part of the liquid that is in none of some containers."""

    def observe(env: Environment) -> Tensor:
        return 1.0 - torch.stack([amount(env) for amount in amounts]).sum(0)

    return observe


cup_pose = common.object_pose(CUP)
"""(N, 7) of the middle of the cup's floor, in the environment's frame."""


def at(point: Vector3) -> TermFunction:
    """Term: (N, 3) a point of the cup's frame, in the environment's frame."""

    @measured_in("m")
    @once_per_state
    def observe(env: Environment) -> Tensor:
        """Return (N, 3) m, the point in the environment's frame."""
        pose = cup_pose(env)
        place = torch.tensor(point, device=env.device).expand(len(pose), 3)
        return pose[:, :3] + quat_rotate(pose[:, 3:], place)

    return observe


middle = at((0.0, 0.0, 0.5 * INNER[2]))
"""(N, 3) m, the cup's middle, in the environment's frame."""
handle = at(GRIP)
"""(N, 3) m, where the cup is grasped, in the environment's frame."""


def reaching(env: Environment) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the handle."""
    return common.nearness(vector_norm(handle(env) - common.hand_pose(env)[:, :3], dim=1), 0.1)


@once_per_state
def hand_to_handle(env: Environment) -> Tensor:
    """(N, 3) m from the hand to where the cup is grasped."""
    return handle(env) - common.hand_pose(env)[:, :3]


def dropped(env: Environment) -> Tensor:
    """(N,) bool: the cup fell off the table."""
    return middle(env)[:, 2] < -0.05


def place_cup(spread: tuple[float, float]) -> EventFunction:
    """Event: stand, cup and liquid at their places, moved together by up to ``spread`` (x, y) m."""

    def place(env: Environment, env_ids: Tensor) -> None:
        low, high = (-spread[0], -spread[1], 0.0), (*spread, 0.0)
        shift = env.world.random.uniform((3,), low, high, env_ids)
        for name in (STAND, CUP):
            thing = env.world.objects[name]
            at_rest = (*thing.spec.pose.position, *thing.spec.pose.orientation)
            pose = torch.tensor(at_rest, device=env.device).repeat(len(shift), 1)
            pose[:, :3] += shift
            thing.set_root_pose(pose, env_ids)
        liquid = env.world.deformables[LIQUID]
        rest = torch.tensor(liquid.spec.pose.transform(liquid.spec.rest_positions), dtype=torch.float32)
        liquid.set_state(rest.to(env.device) + shift[:, None], env_ids=env_ids)

    return place


# Expert --------------------------------------------------------------------------------------------------------------


def holding(position: Tensor, tilt: float = 0.0) -> Tensor:
    """(N, 7) the hand at positions (N, 3) that holds the bar of a cup whose mouth is tilted to +y by ``tilt`` rad."""
    # A negative turn about x tips the cup's z axis towards +y.
    half = -0.5 * tilt
    turn = torch.tensor([math.cos(half), math.sin(half), 0.0, 0.0], device=position.device)
    down = common.pointing_down(position)
    return torch.cat((position, quat_multiply(turn.expand(len(down), 4), down[:, 3:])), dim=1)


def at_handle(env: Environment) -> Tensor:
    """(N, 7) the hand around the handle of a cup on its stand, even if the cup has been pushed away."""
    # Of the stand and not of the cup, which a hand that closes on it pushes: led by it, the hand would follow.
    stand = env.world.objects[STAND].root_pose[:, :3]
    return holding(stand + torch.tensor((GRIP[0], GRIP[1], 0.5 * RAISED + WALL + GRIP[2]), device=stand.device))


def carrying(place: TermFunction, tilt: float = 0.0) -> TermFunction:
    """Term: (N, 7) the hand that leads the cup's middle to a place (N, 3), slowly, as the cup sits in the hand now.

    Args:
        place: of the cup's middle, in the environment's frame.
        tilt: rad by which the cup's mouth is turned to +y.
    """

    def target(env: Environment) -> Tensor:
        now = middle(env)
        way = place(env) - now
        # At most SLOW ahead, and the rest of the way where less is left.
        ahead = way * (SLOW / vector_norm(way, dim=1, keepdim=True).clamp_min(SLOW))
        return holding(now + ahead, tilt)

    def held(env: Environment) -> Tensor:
        return torch.cat((middle(env), cup_pose(env)[:, 3:]), dim=1)

    return picking.hand_for(target, held)


def taking(world: World) -> tuple[Phase, ...]:
    """Phases that take the cup by its handle and lift it off its stand."""
    closing = max(0.5, common.closing_time(world))
    return (
        Phase(picking.back(at_handle, 0.1), position_tolerance=0.02, free=True, timeout=4.0),
        Phase(at_handle, position_tolerance=0.006, timeout=2.0, least=0.02),
        Phase(at_handle, gripper_open=False, dwell=closing, timeout=closing + 0.1),
    )


def gripped(opening: Tensor, away: Tensor) -> Tensor:
    """Return True (N,) where a gripper holds the handle.

    Fingers that strike it do not hold it yet. A student whose hand rose then would rise while the fingers close, where
    they close slowly, and take the cup too high.

    Args:
        opening: (N,) of the gripper, from 0 to 1.
        away: (N,) m from the hand to where the cup is grasped.
    """
    least, most = HELD
    return (opening > least) & (opening < most) & (away < 0.016)


def taking_stage(env: Environment, opening: Tensor) -> tuple[Tensor, Tensor]:
    """Phases of :func:`taking` that fit the state, for an expert that teaches.

    Args:
        env: with the cup.
        opening: (N,) of the gripper, from 0 to 1.

    Returns:
        (N,) int64 of the phase of a hand that does not hold the cup, and (N,) bool, whether it does.
    """
    held = gripped(opening, vector_norm(hand_to_handle(env), dim=1))
    stage = stages.lifting(common.hand_pose(env), at_handle(env), torch.zeros_like(held), closing=opening < 0.9)
    return stage, held


# Configuration -------------------------------------------------------------------------------------------------------


@dataclass
class CupState(ObservationGroup):
    """The arm's joints and hand, the cup, how much is in it, and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    cup_pose: ObservationTerm | None = ObservationTerm(cup_pose)
    in_cup: ObservationTerm | None = ObservationTerm(
        in_cup, unit="1", meaning=Meaning("part of the liquid that is in the cup, from 0 to 1")
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class CupRewards:
    """Rewards of the hand at the handle, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class CupTerminations:
    """An episode ends early where the cup falls off the table."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class CupEvents:
    """Robot and cup are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cup: EventTerm | None = EventTerm(place_cup((0.03, 0.06)))


@dataclass(kw_only=True)
class CupTask(Task):
    """A cup of liquid on a stand before an arm, whose gripper takes it by its handle."""

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the cup is to be poured from within reach: it starts on 72 cm²"),
            TaskException(TaskCheck.START_YAW, "the handle faces the robot, and the mouth is to tilt to its left"),
        ),
    )
    spacing: float = 0.01
    """Metres between particles of the liquid: 216 of them fill the cup, and 1,000 at 6 mm."""
    density: float = 1000.0
    """kg/m^3 of the liquid."""
    viscosity: float = 1.0
    """Pa s of the liquid, as of glycerol: water has 1e-3, olive oil 0.1, honey 10."""
    grip_force: float = 50.0
    """Newtons at most that the gripper closes with: less, and a full cup turns about the fingers by its weight."""
    place: tuple[float, float] = (0.5, -0.1)
    """Metres in x and y of the stand."""
    terminations: CupTerminations = field(default_factory=CupTerminations)

    def with_cup(self, *objects: ObjectSpec, markers: tuple[MarkerSpec, ...] = ()) -> Scene:
        """The robot at the work bench, with the filled cup on its stand and those objects."""
        x, y = self.place
        stand = SolidOptions(mass=1.0, fixed_base=True, pose=Pose((x, y, 0.5 * RAISED)))
        floor = RAISED + WALL
        half = (0.5 * INNER[0], 0.5 * INNER[1], 0.5 * FILLED)
        liquid = Fluid(
            LIQUID, half, self.density, Pose((x, y, floor + half[2])), self.viscosity, self.spacing,
        )  # fmt: skip
        return Scene(
            robots=(matter.with_grip_force(arm(self.robot), self.grip_force),),
            objects=(work_bench(), box(STAND, (0.08, 0.08, RAISED), **stand), cup(Pose((x, y, floor))), *objects),
            deformables=(liquid,),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=markers,
            physics_dt=self.physics_dt,
            # A cup hangs at one end in the fingers for seconds, about which it would turn by its weight.
            firm_friction=True,
        )
