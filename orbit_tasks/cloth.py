"""Base of tasks of a cloth: the cloth on a smooth tray, its observations, and how a hand takes it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links, shapes_in_frame
from orbit_assets.deformables import corners, sheet
from orbit_assets.objects import BENCH_HEIGHT, SolidOptions, box, work_bench
from orbit_core.envs import Environment, ObservationTerm, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import ROBOT, TaskMetadata
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.mdp import common
from orbit_core.scene import Cloth, MarkerSpec, ObjectSpec, PhysicsMaterial, Pose, Scene
from orbit_core.scene.pose import Vector3
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Phase
from orbit_tasks.mdp import matter

CLOTH = "cloth"
SMOOTH = PhysicsMaterial(static_friction=0.2, dynamic_friction=0.2)
# Height in metres of a low tray.
TRAY = 0.02
# Metres below a tray's top to which fingers that press on the cloth are sent.
PRESSED = 0.0065
# In which the reach of fingers is tabulated from open to closed.
STEPS = 16
# Of their way that fingers close while the hand follows.
SOON = 0.25
# Metres above the table at which a hand carries a cloth past other things.
CARRIED = 0.3


@dataclass(kw_only=True)
class ClothTask(Task):
    """A square cloth on a tray before an arm with a gripper that holds it by friction alone."""

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
    )
    size: float = 0.2
    """Metres of the cloth's sides."""
    particles: int = 21
    """Along each side."""
    area_density: float = 0.2
    """kg/m^2 of the cloth."""
    grip_force: float = 15.0
    """Newtons at most that the gripper closes with."""

    def cloth(self, position: Vector3, yaw: float = 0.0) -> Cloth:
        """The cloth flat on what is at a position, in metres, turned by ``yaw`` rad; friction 0.2."""
        counts = (self.particles, self.particles)
        x, y, z = position
        pose = Pose.from_euler(0.0, 0.0, yaw, (x, y, z + 0.5 * Cloth.thickness))
        mesh = sheet((self.size, self.size), counts)
        return Cloth(CLOTH, mesh, self.area_density, pose, friction=0.2, key_points=corners(counts))

    def on_bench(self, cloth: Cloth, *objects: ObjectSpec, markers: tuple[MarkerSpec, ...] = ()) -> Scene:
        """The robot at the work bench, with the cloth and those objects on it."""
        return Scene(
            robots=(matter.with_grip_force(task_robots.arm(self.robot), self.grip_force),),
            objects=(work_bench(), *objects),
            deformables=(cloth,),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=markers,
            physics_dt=self.physics_dt,
        )


def tray(size: Vector3, x: float, y: float = 0.0, material: PhysicsMaterial = SMOOTH) -> ObjectSpec:
    """A fixed block that stands on the bench, around (x, y); ``size`` in metres."""
    place = SolidOptions(mass=1.0, fixed_base=True, pose=Pose((x, y, 0.5 * size[2])), material=material)
    return box("tray", size, **place)


def key_point(name: str) -> TermFunction:
    """Term: (N, 3) a key point of the cloth, in the environment's frame."""

    @once_per_state
    def observe(env: Environment) -> Tensor:
        """(N, 3) m, in the environment's frame."""
        return env.world.deformables[CLOTH].key_point(name)

    return observe


middle = key_point("middle")
"""(N, 3) the cloth's middle, in the environment's frame."""


def reaching(name: str) -> TermFunction:
    """Term: (N,) in [0, 1], how near the hand is to a key point of the cloth."""

    def observe(env: Environment) -> Tensor:
        point = env.world.deformables[CLOTH].key_point(name)
        return common.nearness(vector_norm(point - common.hand_pose(env)[:, :3], dim=1), 0.1)

    return observe


@once_per_state
def let_go(env: Environment) -> Tensor:
    """(N,) bool: whether no particle of the cloth is within 3 cm of the hand."""
    hand = common.hand_pose(env)[:, None, :3]
    return vector_norm(env.world.deformables[CLOTH].positions - hand, dim=2).amin(1) > 0.03


def at_height(position: Tensor, height: float | Tensor) -> Tensor:
    """(N, 7) the hand pointing down, at positions or poses (N, 3 or 7), its frame at a height, or heights (N,)."""
    lifted = position[:, :3].clone()
    lifted[:, 2] = height
    return common.pointing_down(lifted)


def over(point: TermFunction, height: float) -> TermFunction:
    """Term: (N, 7) the hand over what a term (N, 3) gives, its frame at a height in the environment."""
    return lambda env: at_height(point(env), height)


def here(height: float) -> TermFunction:
    """Term: (N, 7) the hand where it is, its frame at a height in the environment."""
    return lambda env: at_height(common.hand_pose(env), height)


def still(env: Environment) -> Tensor:
    """(N, 7) the hand where it is."""
    return common.hand_pose(env)


def finger_reach(world: World, closed: bool | float) -> float:
    """Metres that the gripper's fingers reach beyond the frame between them, open, closed or in between."""
    spec = world.robots[ROBOT].spec
    effector, gripper = spec.end_effector, spec.end_effector.gripper
    assert gripper is not None  # the scene's robot was asked for one
    first, last = (gripper_posture(spec, gripper, v) for v in (gripper.open_position, gripper.closed_position))
    posture = {name: value + float(closed) * (last[name] - value) for name, value in first.items()}
    clouds = shapes_in_frame(spec, effector.frame, gripping_links(spec, gripper), posture)
    return max(float(cloud[:, 2].max()) for cloud in clouds)


def pressed(world: World, depth: float = PRESSED) -> float:
    """Return the metres below the tray's top to which open fingers are sent, ``depth`` for those that slide.

    Fingers that close on arcs reach further down as they do, and press by that: sent lower, they would be stuck.
    """
    return max(0.0, depth - max(0.0, finger_reach(world, True) - finger_reach(world, False)))


def following(world: World, base: float) -> TermFunction:
    """Term: (N,) metres of the hand's frame so high that its fingers reach down to ``base`` however far they closed."""
    robot = world.robots[ROBOT]
    gripper = robot.spec.end_effector.gripper
    assert gripper is not None
    first, last = (gripper_positions(robot.spec, gripper, v) for v in (gripper.open_position, gripper.closed_position))
    joint = next(iter(first))
    way = last[joint] - first[joint]
    reaches = torch.tensor([finger_reach(world, n / STEPS) for n in range(STEPS + 1)], device=world.device)

    def height(env: Environment) -> Tensor:
        share = STEPS * ((robot.joint_positions[:, joint] - first[joint]) / way + SOON).clamp(0.0, 1.0)
        below = share.long().clamp(max=STEPS - 1)
        return base + torch.lerp(reaches[below], reaches[below + 1], share - below)

    return height


def pressing(world: World) -> TermFunction:
    """Term: (N, 7) the hand where it is, so high that its fingers press on the tray however far they have closed."""
    height = following(world, TRAY - pressed(world))

    def pose(env: Environment) -> Tensor:
        return at_height(common.hand_pose(env)[:, :3], height(env))

    return pose


def pinching(world: World, rest: float = 0.0) -> tuple[Phase, ...]:
    """Phases that take the cloth by its middle where it is flat on a low tray.

    The open fingers press on it, and as they close the cloth between them buckles up and is held.

    Args:
        world: with the arm.
        rest: seconds that the fingers rest on the cloth before they close.
    """
    opened = TRAY - pressed(world) + finger_reach(world, closed=False)
    down = over(middle, opened)
    resting = (Phase(down, position_tolerance=0.03, dwell=rest, timeout=rest),) if rest else ()
    return (
        Phase(over(middle, opened + 0.1), position_tolerance=0.02, free=True),
        Phase(down, position_tolerance=0.008, timeout=1.0),
        *resting,
        Phase(pressing(world), gripper_open=False, dwell=0.7, timeout=0.7),
    )


@dataclass
class ClothState(matter.DeformableState):
    """The arm's joints and hand, the cloth's key points and the last action."""

    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(CLOTH))


@dataclass
class Smoothness:
    """Rewards, negative ones, of what is fast or abrupt."""

    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class TimeLimit:
    """Only the time limit ends an episode."""
