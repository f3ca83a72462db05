"""Cloth-Dropping: pinch a cloth that lies flat on a tray and drop it into a container beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.assets.deformables import corners, open_box, sheet
from orbit_core.assets.objects import SolidOptions, box
from orbit_core.envs import EventTerm, Expert, ObservationGroup, ObservationTerm, Phase, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.terms import once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, matter
from orbit_core.scene import Cloth, PhysicsMaterial, Pose, Region, Scene, look_at

CLOTH, CONTAINER = "cloth", "container"
TRAY = 0.02
"""Height in metres of the smooth tray, on which the cloth lies."""
PRESSED = 0.003
"""Metres from the tray to the frame between the finger pads, which reach 9 mm beyond it: they press on the cloth."""
INNER = (0.18, 0.18, 0.12)
"""Metres within the container."""


@once_per_state
def middle(world: World, task: ClothDropping) -> Tensor:
    """(N, 3) the cloth's middle, in the environment's frame."""
    return world.deformables[CLOTH].key_point("middle")


@once_per_state
def container(world: World, task: ClothDropping) -> Tensor:
    """(N, 3) the middle of the container's floor."""
    return world.objects[CONTAINER].root_pose[:, :3]


@once_per_state
def distance(world: World, task: ClothDropping) -> Tensor:
    """(N,) metres between the cloth's middle and the container's, seen from above and, out of it, in height."""
    away = middle(world, task) - container(world, task)
    above = (away[:, 2] - INNER[2]).clamp_min(0.0)
    return torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + above**2)


@once_per_state
def inside(world: World, task: ClothDropping) -> Tensor:
    """(N,) in [0, 1]: the part of the cloth that is in the container."""
    half = Pose((0.0, 0.0, 0.5 * INNER[2]))
    region = Region((0.5 * INNER[0] + 0.01, 0.5 * INNER[1] + 0.01, 0.5 * INNER[2] + 0.02), half, CONTAINER, CONTAINER)
    return world.deformables[CLOTH].share_inside(region)


def reaching(world: World, task: ClothDropping) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the cloth's middle."""
    return common.nearness(vector_norm(middle(world, task) - common.hand_pose(world, task)[:, :3], dim=1), 0.1)


def place_container(world: World, task: ClothDropping, env_ids: Tensor) -> None:
    """Place the container up to 4 cm off its place each way."""
    thing = world.objects[CONTAINER]
    shift = world.random.uniform((2,), -0.04, 0.04, env_ids)
    x, y, z = thing.spec.pose.position
    pose = torch.tensor([x, y, z, 1.0, 0.0, 0.0, 0.0], device=world.device).repeat(len(env_ids), 1)
    pose[:, :2] += shift
    thing.set_root_pose(pose, env_ids)


def at_cloth(world: World, task: ClothDropping, height: float) -> Tensor:
    """(N, 7) the hand over the cloth's middle, its frame at a height above the tray."""
    position = middle(world, task).clone()
    position[:, 2] = TRAY + height
    return common.pointing_down(position)


def closing(world: World, task: ClothDropping) -> Tensor:
    """(N, 7) the hand where it is, pressed on the tray: the cloth comes to it as it closes."""
    position = common.hand_pose(world, task)[:, :3].clone()
    position[:, 2] = TRAY + PRESSED
    return common.pointing_down(position)


def raised(world: World, task: ClothDropping) -> Tensor:
    """(N, 7) the hand where it is, as high as it carries the cloth."""
    position = common.hand_pose(world, task)[:, :3].clone()
    position[:, 2] = 0.3
    return common.pointing_down(position)


def over_container(world: World, task: ClothDropping) -> Tensor:
    """(N, 7) the hand above the container, the cloth hanging into it."""
    position = container(world, task).clone()
    position[:, 2] = 0.3
    return common.pointing_down(position)


@dataclass
class ClothDroppingState(ObservationGroup):
    """The arm's joints and hand, the cloth's key points, the container and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(CLOTH))
    container: ObservationTerm | None = ObservationTerm(container)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class ClothDroppingObservations:
    """Policy and critic see the state."""

    policy: ClothDroppingState = field(default_factory=ClothDroppingState)
    critic: ObservationGroup | None = None


@dataclass
class ClothDroppingRewards:
    """Rewards of the hand at the cloth, the cloth near the container and in it, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    bring: RewardTerm | None = RewardTerm(lambda world, task: common.nearness(distance(world, task), 0.3), 8.0)
    drop: RewardTerm | None = RewardTerm(inside, 16.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class ClothDroppingTerminations:
    """Only the time limit ends an episode."""


@dataclass
class ClothDroppingEvents:
    """Robot, cloth and container are placed anew for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.05)))
    place_container: EventTerm | None = EventTerm(place_container)


@dataclass(kw_only=True)
class ClothDropping(Task):
    """The cloth lies flat on a smooth tray, anywhere within 5 cm and turned by any angle; the container stands beside.

    Succeeds when its middle is within ``tolerance`` of the container's, ``least_inside`` of it is in the container and
    the gripper does not touch it at the episode's end. Metric: that distance.
    """

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    episode_length: float = 8.0
    ppo: PpoSettings = PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005)
    view: Pose = look_at(eye=(1.3, 0.9, 0.75), target=(0.45, 0.12, 0.08))
    size: float = 0.2
    """Metres of the cloth's sides."""
    particles: int = 21
    """Along each side."""
    area_density: float = 0.2
    """kg/m^2 of the cloth."""
    grip_force: float = 15.0
    """Newtons at most that the gripper closes with."""
    tolerance: float = 0.08
    """Metres."""
    least_inside: float = 0.8
    observations: ClothDroppingObservations = field(default_factory=ClothDroppingObservations)
    rewards: ClothDroppingRewards = field(default_factory=ClothDroppingRewards)
    terminations: ClothDroppingTerminations = field(default_factory=ClothDroppingTerminations)
    events: ClothDroppingEvents = field(default_factory=ClothDroppingEvents)

    def scene(self) -> Scene:
        counts = (self.particles, self.particles)
        smooth = PhysicsMaterial(static_friction=0.2, dynamic_friction=0.2)
        place = SolidOptions(mass=1.0, fixed_base=True, pose=Pose((0.48, -0.08, 0.5 * TRAY)), material=smooth)
        above = Pose((0.48, -0.08, TRAY + 0.5 * Cloth.thickness))
        mesh = sheet((self.size, self.size), counts)
        cloth = Cloth(CLOTH, mesh, self.area_density, above, friction=0.2, key_points=corners(counts))
        return Scene(
            robots=(matter.with_grip_force(common.arm(self.robot), self.grip_force),),
            objects=(
                common.work_bench(),
                box("tray", size=(0.45, 0.45, TRAY), **place),
                open_box(CONTAINER, INNER, Pose((0.48, 0.29, 0.005)), material=smooth),
            ),
            deformables=(cloth,),
            terrain=(common.floor(-common.BENCH_HEIGHT),),
            physics_dt=self.physics_dt,
        )

    def success(self, world: World) -> Tensor:
        hand = common.hand_pose(world, self)[:, :3]
        away = vector_norm(world.deformables[CLOTH].positions - hand[:, None], dim=2).amin(1) > 0.03
        return (distance(world, self) < self.tolerance) & (inside(world, self) >= self.least_inside) & away

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"container_distance_m": distance(world, self), "inside": inside(world, self)}

    def expert(self, world: World) -> Expert:
        def over(world: World, task: ClothDropping) -> Tensor:
            return at_cloth(world, task, 0.1)

        def on(world: World, task: ClothDropping) -> Tensor:
            return at_cloth(world, task, PRESSED)

        return Expert(
            world,
            self,
            (
                Phase(over, position_tolerance=0.02, free=True),
                Phase(on, position_tolerance=0.008, timeout=1.0),
                Phase(closing, gripper_open=False, dwell=0.7, timeout=0.7),
                Phase(raised, gripper_open=False, position_tolerance=0.03, timeout=1.0),
                Phase(over_container, gripper_open=False, position_tolerance=0.02, dwell=0.5, timeout=2.0),
                Phase(over_container),
            ),
            position_lead=0.05,
        )
