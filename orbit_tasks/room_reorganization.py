"""Room-Reorganization: bring things that lie about on furniture to their places on a shelf, one after another."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import box, cylinder
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task, TerminationTerm
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Meaning, measured_in, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import MarkerShape, MarkerSpec, ObjectSpec, Pose, RobotSpec, Scene, look_at
from orbit_motion.experts import Expert, Phase, Retry
from orbit_motion.planning import BasePlannerConfig
from orbit_tasks import room
from orbit_tasks.mdp import picking
from orbit_tasks.mobile import Mobile, base_pose, base_radius, mobile, sag_rate, start_within, tipped

# Names of what is to be tidied up.
THINGS = ("cube", "can", "carton")
# Of each, m.
HALF_HEIGHTS = (0.025, 0.04, 0.05)
# Metres from a piece's front edge to the middles of what stands on it.
INSET = 0.1
# Metres by which the shelf's top is higher than the tables'.
SHELF_RAISED = 0.15


def things() -> tuple[ObjectSpec, ...]:
    """A cube, a can and a carton."""
    return (
        box("cube", (0.05, 0.05, 0.05), mass=0.1, color=(0.8, 0.2, 0.15, 1.0)),
        cylinder("can", 0.025, 0.08, mass=0.12, color=(0.2, 0.5, 0.8, 1.0)),
        box("carton", (0.05, 0.05, 0.1), mass=0.12, color=(0.3, 0.65, 0.3, 1.0)),
    )


class RoomMemory(TaskState):
    """State of a room: the places of things in an episode, and furniture that suits the robot."""

    places: Tensor = buffer(len(THINGS), 3)
    """(N, 3, 3) of the things' middles in the environment's frame, m."""
    docks: Tensor = buffer(len(THINGS), 2, 3)
    """(N, 3, 2, 3) x, y and heading of the base before each thing's first stand, and before its place."""
    surface: float
    """Metres from the floor to the tops of desk and sideboard."""
    standoff: float
    """Metres from a piece's front to the middle of a base that stands before it."""

    def start(self, env: Environment) -> None:
        self.surface, self.standoff = _fit(common.robot_of(env.world).spec)


def _fit(robot: RobotSpec) -> tuple[float, float]:
    """Find the height of desk and sideboard, and how far off a base stands, that suit the arm, m."""
    space = common.placed_workspace(robot)
    # Things on the tables are within the workspace: a little above its lower face and beyond its near one.
    return space.low[2] - 0.1, space.low[0] + 0.05


@measured_in("m")
@once_per_state
def positions(env: Environment[RoomReorganization]) -> Tensor:
    """(N, 3, 3) of the things."""
    return torch.stack([env.world.objects[name].root_pose[:, :3] for name in THINGS], 1)


@once_per_state
def distances(env: Environment[RoomReorganization, RoomMemory]) -> Tensor:
    """(N, 3) metres from each thing to its place."""
    return vector_norm(positions(env) - env.state.places, dim=2)


@once_per_state
def in_place(env: Environment[RoomReorganization]) -> Tensor:
    """(N, 3) bool: the thing rests within the tolerance of its place, and the hand has let go of it."""
    away = vector_norm(positions(env) - common.hand_pose(env)[:, None, :3], dim=2)
    return (distances(env) < env.task.tolerance) & (away > 0.05)


def share_in_place(env: Environment[RoomReorganization]) -> Tensor:
    """(N,) in [0, 1]"""
    return in_place(env).float().mean(1)


def nearness(env: Environment[RoomReorganization]) -> Tensor:
    """(N,) in [0, 1]: how near the things are to their places, over metres."""
    return common.nearness(distances(env), 1.0).mean(1)


def reaching(env: Environment[RoomReorganization]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the first thing that is not in its place; 1 where all are."""
    away = vector_norm(positions(env) - common.hand_pose(env)[:, None, :3], dim=2)
    done = in_place(env)
    # The first zero; where all are done the result is replaced below.
    first = done.long().argmin(1, keepdim=True)
    return torch.where(done.all(1), 1.0, common.nearness(away.gather(1, first).squeeze(1), 0.5))


def place_things(env: Environment[RoomReorganization, RoomMemory], env_ids: Tensor) -> None:
    """Draw the room, in which slot of desk and sideboard each thing stands, a little off and turned, and its place."""
    room.place_furniture(env.world, env_ids)
    slots = [(piece, y) for piece in (room.DESK, room.SIDEBOARD) for y in piece.slots]
    # Sorting random numbers gives a permutation for each environment in one operation.
    taken = env.world.random.uniform((len(slots),), env_ids=env_ids).argsort(1)
    order = env.world.random.uniform((len(THINGS),), env_ids=env_ids).argsort(1)
    stands = torch.stack([_stand(env, piece, y, env_ids) for piece, y in slots], 1)
    goals = torch.stack([_stand(env, room.SHELF, y, env_ids) for y in room.SHELF.slots], 1)
    rows = torch.arange(len(env_ids), device=env.device)
    off = env.world.random.uniform((len(THINGS), 3), (-0.02, -0.02, -math.pi), (0.02, 0.02, math.pi), env_ids)
    for number, name in enumerate(THINGS):
        start, goal = stands[rows, taken[:, number]], goals[rows, order[:, number]]
        up = torch.tensor([0.0, 0.0, HALF_HEIGHTS[number]], device=env.device)
        place = torch.cat((start[:, :3] + up, start[:, 3:4]), 1)
        # x, y and yaw; the height is that of the furniture.
        place[:, [0, 1, 3]] += off[:, number]
        env.world.objects[name].set_root_pose(common.standing(place), env_ids)
        env.state.places[env_ids, number] = goal[:, :3] + up
        env.state.docks[env_ids, number, 0], env.state.docks[env_ids, number, 1] = start[:, 4:], goal[:, 4:]
    common.place_markers(env.world, [f"{name}_place" for name in THINGS], env.state.places[env_ids], env_ids)


def _stand(
    env: Environment[RoomReorganization, RoomMemory], piece: room.Furniture, y: float, env_ids: Tensor
) -> Tensor:
    """(n, 7): where a thing stands on a piece of furniture and the piece's yaw; where a base stands before it."""
    pose = env.world.objects[piece.name].root_pose[env_ids]
    slot = torch.full_like(pose[:, 0], y)
    yaw = torch.full_like(slot, piece.yaw)[:, None]
    front = -0.5 * piece.depth
    thing, base = piece.local(front + INSET, slot, pose), piece.local(front - env.state.standoff, slot, pose)
    return torch.cat((thing, pose[:, 2:3], yaw, base, yaw), 1)


@dataclass
class RoomState(ObservationGroup):
    """The arm's joints and hand, the base, the things and their places, and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    base_pose: ObservationTerm | None = ObservationTerm(base_pose)
    positions: ObservationTerm | None = ObservationTerm(positions)
    places: ObservationTerm | None = ObservationTerm(
        lambda env: env.state.places,
        unit="m",
        meaning=Meaning("positions of the places, one after the other", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class RoomObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: RoomState = field(default_factory=RoomState)
    critic: ObservationGroup | None = None


@dataclass
class RoomRewards:
    """Rewards of the hand at the next thing, things near their places and in them, less what is abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    near: RewardTerm | None = RewardTerm(nearness, 5.0)
    in_place: RewardTerm | None = RewardTerm(share_in_place, 20.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)


@dataclass
class RoomTerminations:
    """An episode ends early where the base falls over."""

    tipped: TerminationTerm | None = TerminationTerm(tipped)


@dataclass
class RoomEvents:
    """The room, the robot in its free part and the things are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(start_within((-1.2, -1.8), (1.2, -1.4)))
    place_things: EventTerm | None = EventTerm(place_things)


@dataclass(kw_only=True)
class RoomReorganization(Mobile, Task):
    """Three things stand on a desk and a sideboard; each has a place on a shelf at the opposite wall.

    Where furniture, crate and things stand, and which place is whose, is drawn for each episode. Succeeds when all are
    within ``tolerance`` of their places, let go of, at the episode's end. Metrics: the part of them that is, and the
    sum of their distances.
    """

    state_type: ClassVar[type[TaskState]] = RoomMemory
    robot: str = "base_omni_franka_panda"
    action: str = "joint_position"
    episode_length: float = 60.0
    metadata: TaskMetadata = TaskMetadata(
        view=look_at(eye=(-0.2, -4.6, 4.8), target=(0.0, -0.1, 0.0)),
    )
    tolerance: float = 0.05
    """Metres."""
    observations: RoomObservations = field(default_factory=RoomObservations)
    rewards: RoomRewards = field(default_factory=RoomRewards)
    terminations: RoomTerminations = field(default_factory=RoomTerminations)
    events: RoomEvents = field(default_factory=RoomEvents)

    def scene(self) -> Scene:
        robot = mobile(self.robot)
        surface, _ = _fit(robot)
        heights = {piece.name: surface for piece in room.PIECES} | {"shelf": surface + SHELF_RAISED}
        marks = tuple(
            MarkerSpec(
                f"{thing.name}_place", MarkerShape.SPHERE, size=0.03, color=thing.articulation.root.visuals[0].color
            )
            for thing in things()
        )
        # Surroundings bring walls of their own.
        walls = () if self.surroundings else room.walls()
        scene = Scene(
            robots=(robot,),
            objects=(*room.furniture(heights), *self._laid_out()),
            terrain=(common.floor(), *walls),
            markers=marks,
            physics_dt=self.physics_dt,
            firm_friction=bool(robot.feet),
        )
        return self.in_surroundings(scene)

    def _laid_out(self) -> tuple[ObjectSpec, ...]:
        """The things where they stand until an episode begins: side by side on the floor."""
        laid = zip(things(), HALF_HEIGHTS, (-0.3, 0.0, 0.3), strict=True)
        return tuple(replace(thing, pose=Pose((x, 1.0, half))) for thing, half, x in laid)

    def success(self, env: Environment) -> Tensor:
        return in_place(env).all(1)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"objects_in_place": share_in_place(env), "distance_m": distances(env).sum(1)}

    def expert(self, env: Environment[Any, RoomMemory]) -> Expert:
        spec = common.robot_of(env.world).spec
        half = (0.5 * room.LENGTH, 0.5 * room.WIDTH)
        planner = BasePlannerConfig(
            radius=base_radius(spec), height=env.state.surface, low=(-half[0], -half[1]), high=(half[0], half[1])
        )
        phases = [phase for number in range(len(THINGS)) for phase in tidying(env.world, number, env.state.surface)]
        return Expert(env, phases, planner=planner, sag_rate=sag_rate(env.world))


def tidying(world: World, number: int, surface: float) -> tuple[Phase, ...]:
    """The phases that bring one thing to its place: to it, take it, to the shelf, put it down."""
    name, high = THINGS[number], surface + SHELF_RAISED + 0.25

    def pose(env: Environment[RoomReorganization]) -> Tensor:
        return env.world.objects[name].root_pose

    def grasp(env: Environment[RoomReorganization, RoomMemory]) -> Tensor:
        thing, facing = env.world.objects[name].root_pose, env.state.docks[:, number, 0, 2]
        turned = 2.0 * torch.atan2(thing[:, 6], thing[:, 3]) - facing
        quarter = 0.5 * math.pi
        # Things are square or round: of four equal grasps the one that needs the least turn of the wrist.
        yaw = facing + turned - quarter * torch.round(turned / quarter)
        return torch.cat((thing[:, :3], common.facing_down(yaw)), 1)

    def place(env: Environment[RoomReorganization, RoomMemory]) -> Tensor:
        return torch.cat((env.state.places[:, number], common.facing_down(env.state.docks[:, number, 1, 2])), 1)

    def lifted(env: Environment[RoomReorganization]) -> Tensor:
        return pose(env)[:, 2] > surface + 0.1

    up = Phase(picking.straight_up(high), False, 0.03, timeout=2.0, retry=Retry(4, lifted))
    return (
        _drive(number, 0, True),
        *picking.pick(world, grasp, free=True),
        up,
        _drive(number, 1, False),
        *picking.put(picking.hand_for(place, pose), high),
    )


def _drive(number: int, end: int, gripper_open: bool) -> Phase:
    def dock(env: Environment[RoomReorganization, RoomMemory]) -> Tensor:
        return env.state.docks[:, number, end]

    return Phase(None, gripper_open, 0.03, 0.05, base=dock, timeout=14.0)
