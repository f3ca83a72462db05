"""Cloth-Lifting: pinch a cloth that lies flat on a tray and hold its middle at a sampled position."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.assets.deformables import corners, sheet
from orbit_core.assets.objects import SolidOptions, box
from orbit_core.envs import EventTerm, Expert, ObservationGroup, ObservationTerm, Phase, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.terms import once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, matter
from orbit_core.scene import Cloth, MarkerShape, MarkerSpec, PhysicsMaterial, Pose, Scene, look_at

CLOTH = "cloth"
TRAY = 0.02
"""Height in metres of the smooth tray, on which the cloth lies."""
PRESSED = 0.003
"""Metres from the tray to the frame between the finger pads, which reach 9 mm beyond it: they press on the cloth."""


@once_per_state
def middle(world: World, task: ClothLifting) -> Tensor:
    """(N, 3) the cloth's middle, in the environment's frame."""
    return world.deformables[CLOTH].key_point("middle")


@once_per_state
def goal_distance(world: World, task: ClothLifting) -> Tensor:
    """(N,) metres between the cloth's middle and the goal."""
    return vector_norm(task.goal - middle(world, task), dim=1)


def reaching(world: World, task: ClothLifting) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the cloth's middle."""
    return common.nearness(vector_norm(middle(world, task) - common.hand_pose(world, task)[:, :3], dim=1), 0.1)


def lifted(world: World, task: ClothLifting) -> Tensor:
    """(N,) 1 where the cloth's middle is 5 cm above the tray, else 0."""
    return (middle(world, task)[:, 2] > TRAY + 0.05).float()


def tracking(world: World, task: ClothLifting, scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the lifted middle is to the goal."""
    return lifted(world, task) * common.nearness(goal_distance(world, task), scale)


def sample_goal(world: World, task: ClothLifting, env_ids: Tensor) -> None:
    """Sample the goal 20 to 35 cm above the table, within 10 cm of the tray's middle each way."""
    x = world.scene.deformables[0].pose.position[0]
    task.goal[env_ids] = world.random.uniform((3,), (x - 0.1, -0.1, 0.2), (x + 0.05, 0.1, 0.35), env_ids)
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=world.device).expand(len(env_ids), 4)
    world.markers["goal"].set_pose(torch.cat((task.goal[env_ids], upright), dim=1), env_ids)


def at_cloth(world: World, task: ClothLifting, height: float) -> Tensor:
    """(N, 7) the hand over the cloth's middle, its frame at a height above the tray."""
    position = middle(world, task).clone()
    position[:, 2] = TRAY + height
    return common.pointing_down(position)


def closing(world: World, task: ClothLifting) -> Tensor:
    """(N, 7) the hand where it is, pressed on the tray: the cloth comes to it as it closes."""
    position = common.hand_pose(world, task)[:, :3].clone()
    position[:, 2] = TRAY + PRESSED
    return common.pointing_down(position)


def at_goal(world: World, task: ClothLifting) -> Tensor:
    """(N, 7) the hand where the cloth's middle comes to the goal, as it hangs in the hand now."""
    return common.pointing_down(task.goal + common.hand_pose(world, task)[:, :3] - middle(world, task))


@dataclass
class ClothLiftingState(ObservationGroup):
    """The arm's joints and hand, the cloth's key points, the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(CLOTH))
    goal: ObservationTerm | None = ObservationTerm(lambda world, task: task.goal)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class ClothLiftingObservations:
    """Policy and critic see the state."""

    policy: ClothLiftingState = field(default_factory=ClothLiftingState)
    critic: ObservationGroup | None = None


@dataclass
class ClothLiftingRewards:
    """Rewards of the hand at the cloth, the cloth off the tray and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 10.0)
    track: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.3), 16.0)
    track_finely: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.05), 5.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class ClothLiftingTerminations:
    """Only the time limit ends an episode."""


@dataclass
class ClothLiftingEvents:
    """Robot, cloth and goal are placed anew for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.05)))
    sample_goal: EventTerm | None = EventTerm(sample_goal)


@dataclass(kw_only=True)
class ClothLifting(Task):
    """The cloth lies flat on a smooth tray, anywhere within 5 cm and turned by any angle.

    Succeeds when the cloth's middle is within ``tolerance`` of the goal at the episode's end. Metric: that distance.
    """

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    episode_length: float = 6.0
    ppo: PpoSettings = PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005)
    view: Pose = look_at(eye=(1.3, 0.8, 0.7), target=(0.45, 0.0, 0.12))
    size: float = 0.2
    """Metres of the cloth's sides."""
    particles: int = 21
    """Along each side."""
    area_density: float = 0.2
    """kg/m^2 of the cloth."""
    grip_force: float = 15.0
    """Newtons at most that the gripper closes with."""
    tolerance: float = 0.03
    """Metres."""
    observations: ClothLiftingObservations = field(default_factory=ClothLiftingObservations)
    rewards: ClothLiftingRewards = field(default_factory=ClothLiftingRewards)
    terminations: ClothLiftingTerminations = field(default_factory=ClothLiftingTerminations)
    events: ClothLiftingEvents = field(default_factory=ClothLiftingEvents)
    goal: Tensor = field(init=False)
    """(N, 3) in the environment's frame."""

    def scene(self) -> Scene:
        counts = (self.particles, self.particles)
        mesh = sheet((self.size, self.size), counts)
        smooth = PhysicsMaterial(static_friction=0.2, dynamic_friction=0.2)
        place = SolidOptions(mass=1.0, fixed_base=True, pose=Pose((0.5, 0.0, 0.5 * TRAY)), material=smooth)
        above = Pose((0.5, 0.0, TRAY + 0.5 * Cloth.thickness))
        cloth = Cloth(CLOTH, mesh, self.area_density, above, friction=0.2, key_points=corners(counts))
        return Scene(
            robots=(matter.with_grip_force(common.arm(self.robot), self.grip_force),),
            objects=(common.work_bench(), box("tray", size=(0.5, 0.6, TRAY), **place)),
            deformables=(cloth,),
            terrain=(common.floor(-common.BENCH_HEIGHT),),
            markers=(MarkerSpec("goal", MarkerShape.SPHERE, size=0.03),),
            physics_dt=self.physics_dt,
        )

    def start(self, world: World) -> None:
        super().start(world)
        self.goal = torch.zeros(world.num_envs, 3, device=world.device)

    def success(self, world: World) -> Tensor:
        return goal_distance(world, self) < self.tolerance

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(world, self)}

    def expert(self, world: World) -> Expert:
        def over(world: World, task: ClothLifting) -> Tensor:
            return at_cloth(world, task, 0.1)

        def on(world: World, task: ClothLifting) -> Tensor:
            return at_cloth(world, task, PRESSED)

        return Expert(
            world,
            self,
            (
                Phase(over, position_tolerance=0.02, free=True),
                Phase(on, position_tolerance=0.008, timeout=1.0),
                Phase(closing, gripper_open=False, dwell=0.7, timeout=0.7),
                Phase(at_goal, gripper_open=False),
            ),
            position_lead=0.05,
        )
