"""Tower-Of-Hanoi: put soft rings round a rod, in decreasing size."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.audit.robots.postures import gripper_posture, shapes_in_frame
from orbit_assets.deformables import ring
from orbit_assets.objects import SolidOptions, cylinder
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import ROBOT, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Color, KeyPoint, PhysicsMaterial, Pose, Scene, SoftBody, look_at
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks import soft
from orbit_tasks.cloth import Smoothness
from orbit_tasks.mdp import matter, picking

ROD = "rod"
# Metres: radius of the circle in the middle of each ring, the largest first; a hand takes a ring by its outside.
RADII = {"large": 0.027, "middle": 0.0235, "small": 0.02}
COLORS: dict[str, Color] = {
    "large": (0.8, 0.2, 0.15, 1.0), "middle": (0.95, 0.75, 0.15, 1.0), "small": (0.2, 0.5, 0.85, 1.0),
}  # fmt: skip
# Metres: radius of every ring's section.
SECTION = 0.01
# Metres: the rod's radius and height.
ROD_SIZE = (0.004, 0.075)
# Places of rings, in metres; each starts within SPREAD of its place.
PLACES = {"large": (0.42, -0.2), "middle": (0.56, -0.14), "small": (0.42, -0.06)}
SPREAD = 0.02
# Metres above its ring's middle at which a hand takes it: fingertips reach below their frame.
GRASPED = 0.003
# Metres by which a ring is let go above what it falls on.
LOOSE = 0.006
# Metres that are left between the rod's tip and the palm above it.
CLEAR = 0.005


@once_per_state
def rings(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N, 3, 3) middles of the rings, the largest first, in the environment's frame."""
    return torch.stack([env.world.deformables[name].key_point("middle") for name in RADII], dim=1)


@once_per_state
def places(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N, 3, 3) where the rings belong: on each other, round the rod."""
    heights = SECTION * (2.0 * torch.arange(len(RADII), device=env.device) + 1.0)
    foot = env.world.objects[ROD].root_pose[:, :3] * torch.tensor([1.0, 1.0, 0.0], device=env.device)
    return foot[:, None] + torch.stack((torch.zeros_like(heights), torch.zeros_like(heights), heights), dim=1)


@once_per_state
def distances(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N, 3) horizontal metres between rings and the rod."""
    return vector_norm((places(env) - rings(env))[..., :2], dim=2)


@once_per_state
def threaded(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N, 3) bool: the rod is in the ring's hole, and the ring below the rod's tip."""
    holes = torch.tensor([radius - SECTION for radius in RADII.values()], device=env.device)
    return (distances(env) < holes) & (rings(env)[..., 2] < ROD_SIZE[1])


@once_per_state
def in_order(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N, 3) bool: the ring is round the rod, over all larger ones, which are as well."""
    heights = rings(env)[..., 2]
    above = torch.ones_like(heights, dtype=torch.bool)
    above[:, 1:] = heights[:, 1:] > heights[:, :-1] + SECTION
    return (threaded(env) & above).long().cumprod(dim=1).bool()


def staged(env: Environment[TowerOfHanoi], values: Tensor) -> Tensor:
    """(N,) in [0, 1]: the share of rings in place, and for the next one its own value, of ``values`` (N, 3)."""
    count = in_order(env).sum(1)
    following = values.gather(1, count.clamp(max=len(RADII) - 1)[:, None])[:, 0]
    return (count + torch.where(count < len(RADII), following, 0.0)) / len(RADII)


def reaching(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the next ring."""
    way = vector_norm(rings(env) - common.hand_pose(env)[:, None, :3], dim=2)
    return staged(env, common.nearness(way, 0.1))


def tracking(env: Environment[TowerOfHanoi], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the next ring is to the rod, once it is lifted."""
    return staged(env, common.nearness(distances(env), scale) * (rings(env)[..., 2] > 3.0 * SECTION))


def dropped(env: Environment[TowerOfHanoi]) -> Tensor:
    """(N,) bool: a ring fell off the table."""
    return rings(env)[..., 2].amin(1) < -0.05


@dataclass
class HanoiState(ObservationGroup):
    """The arm's joints and hand, key points of the rings, their places and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    large: ObservationTerm | None = ObservationTerm(matter.key_points("large"))
    middle: ObservationTerm | None = ObservationTerm(matter.key_points("middle"))
    small: ObservationTerm | None = ObservationTerm(matter.key_points("small"))
    places: ObservationTerm | None = ObservationTerm(places, unit="m")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class HanoiObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: HanoiState = field(default_factory=HanoiState)
    critic: ObservationGroup | None = None


@dataclass
class HanoiRewards(Smoothness):
    """Rewards of the hand at the next ring, the ring over the rod and round it, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.1), 4.0)
    """Nearness of the next, lifted ring to the rod, within some 0.1 m."""
    thread: RewardTerm | None = RewardTerm(lambda env: in_order(env).float().mean(1), 16.0)
    """Share of the rings that are round the rod in their order."""


@dataclass
class HanoiTerminations:
    """An episode ends early where a ring is dropped off the table."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class HanoiEvents:
    """Robot and rings are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_large: EventTerm | None = EventTerm(matter.place_deformable("large", (SPREAD, SPREAD)))
    place_middle: EventTerm | None = EventTerm(matter.place_deformable("middle", (SPREAD, SPREAD)))
    place_small: EventTerm | None = EventTerm(matter.place_deformable("small", (SPREAD, SPREAD)))


@dataclass(kw_only=True)
class TowerOfHanoi(soft.SoftTask):
    """Three soft rings lie on the table next to a rod, each within 2 cm of its place.

    Succeeds when at the episode's end all are round the rod, the largest below and the smallest on top. Metrics: the
    sum of the distances between rings and rod, and how many are in place and in order.
    """

    metadata: TaskMetadata = TaskMetadata(
        instruction="move the tower of discs to the other peg",
        ppo=PpoSettings(iterations=3000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(1.1, 0.75, 0.55), target=(0.45, -0.02, 0.03)),
        exceptions=(
            TaskException(TaskCheck.START_YAW, "rings look alike at every angle"),
            TaskException(TaskCheck.START_AREA, "each ring starts in a cell of 4 x 4 cm, clear of the hand at another"),
        ),
    )
    episode_length: float = 16.0
    grip_force: float = 3.0
    """Newtons at most that the gripper closes with: more closes the rings' holes."""
    observations: HanoiObservations = field(default_factory=HanoiObservations)
    rewards: HanoiRewards = field(default_factory=HanoiRewards)
    terminations: HanoiTerminations = field(default_factory=HanoiTerminations)
    events: HanoiEvents = field(default_factory=HanoiEvents)

    def scene(self) -> Scene:
        smooth = PhysicsMaterial(static_friction=0.2, dynamic_friction=0.2)
        where = Pose((0.48, 0.14, 0.5 * ROD_SIZE[1]))
        options = SolidOptions(mass=0.1, fixed_base=True, pose=where, material=smooth, color=(0.7, 0.7, 0.75, 1.0))
        return self.on_bench(tuple(self._ring(name) for name in RADII), cylinder(ROD, *ROD_SIZE, **options))

    def _ring(self, name: str) -> SoftBody:
        mesh = ring(RADII[name], SECTION, (24, 12))
        # Two cells along each side: a ring is squeezed as a whole and needs no finer ones.
        return SoftBody(
            name, mesh, self.density, Pose((*PLACES[name], SECTION)), self.youngs_modulus, friction=self.friction,
            resolution=RADII[name] + SECTION + 1e-4, color=COLORS[name],
            key_points=(KeyPoint("middle", tuple(range(len(mesh.vertices)))), *_sides(mesh.vertices)),
        )  # fmt: skip

    def success(self, env: Environment) -> Tensor:
        return in_order(env).all(1)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"rod_distance_m": distances(env).sum(1), "in_order": in_order(env).float().sum(1)}

    def expert(self, env: Environment) -> Expert:
        phases = [phase for index in range(len(RADII)) for phase in _moving(env.world, index)]
        return Expert(env, phases)


def _sides(vertices: np.ndarray) -> tuple[KeyPoint, ...]:
    """Key points of a ring: its outermost vertices along x and y."""
    ways = {"front": (1, 0, 0), "left": (0, 1, 0), "back": (-1, 0, 0), "right": (0, -1, 0)}
    return tuple(KeyPoint(name, (int((vertices @ way).argmax()),)) for name, way in ways.items())


def _grasp(index: int) -> TermFunction:
    """Term: (N, 7) the hand around a ring."""

    def pose(env: Environment) -> Tensor:
        up = torch.tensor([0.0, 0.0, GRASPED], device=env.device)
        return common.pointing_down(rings(env)[:, index] + up)

    return pose


def _depth(world: World) -> float:
    """Metres from the hand's frame up to its palm, where the rod comes in between the open fingers."""
    spec = world.robots[ROBOT].spec
    effector, gripper = spec.end_effector, spec.end_effector.gripper
    assert gripper is not None  # the scene's robot was asked for one
    opened = gripper_posture(spec, gripper, gripper.open_position)
    clouds = shapes_in_frame(spec, effector.frame, spec.articulation.links, opened)
    near = 2.0 * ROD_SIZE[0]
    met = [cloud for cloud in clouds if (cloud[:, :2].min(0) < near).all() and (cloud[:, :2].max(0) > -near).all()]
    return min(-float(cloud[:, 2].max()) for cloud in met)


def _place(index: int, depth: float) -> TermFunction:
    """Term: (N, 7) the hand with which the ring that it holds is round the rod, a little above its place.

    Args:
        index: of the ring.
        depth: metres from the hand's frame up to its palm, which stays above the rod's tip.
    """

    def pose(env: Environment) -> Tensor:
        up = torch.tensor([0.0, 0.0, LOOSE], device=env.device)
        inside = rings(env)[:, index] - common.hand_pose(env)[:, :3]
        way = places(env)[:, index] + up - inside
        lowest = way[:, 2:].clamp_min(ROD_SIZE[1] + CLEAR - depth)
        return common.pointing_down(torch.cat((way[:, :2], lowest), dim=1))

    return pose


def _moving(world: World, index: int) -> tuple[Phase, ...]:
    """Take a ring from outside, thread it onto the rod and let it go."""
    closing, grasp, place = soft.closing_time(world), _grasp(index), _place(index, _depth(world))
    came = Retry(4, lambda env: rings(env)[:, index, 2] > 3.0 * SECTION)
    # Over the rod's tip the ring is aligned: what is free around the rod is a few millimetres.
    over = ROD_SIZE[1] + 0.02 - 2.0 * SECTION * index
    up = picking.straight_up(0.2)
    return (
        Phase(picking.raised(grasp, 0.1), position_tolerance=0.02, timeout=3.0, free=True),
        Phase(grasp, position_tolerance=0.005, timeout=1.5),
        Phase(grasp, gripper_open=False, dwell=closing, timeout=closing + 0.1),
        Phase(up, False, 0.03, math.inf, timeout=2.0, retry=came),
        Phase(picking.raised(place, over), False, position_tolerance=0.003, rotation_tolerance=0.05, timeout=3.0),
        Phase(place, False, position_tolerance=0.004, rotation_tolerance=0.1, timeout=1.5),
        # Still: led by where the ring is, the hand would follow it as it falls and draw it aside.
        Phase(common.hand_pose, dwell=0.3, timeout=0.4),
        Phase(up, True, 0.03, math.inf, timeout=1.5),
    )
