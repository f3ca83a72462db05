"""Flag-Hoisting: take a flag by its staff and raise it beside a mast, until it hangs spread at its place."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import SolidOptions, box
from orbit_core.envs import EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import ENVIRONMENT, POSE, Meaning, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Attachment, MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY
from orbit_tasks.mdp import matter

STAFF, MAST = "staff", "mast"
THICK, TALL = 0.014, 0.03
"""Metres of the staff's section, across and upright."""
CLEAR = 0.0105
"""Metres that the finger tips keep from the tray as they take the staff."""
CORNER = "corner++"
"""The key point that belongs beside the mast: one end of the edge that is on the staff."""

corner = cloth.key_point(CORNER)
"""(N, 3) the flag's corner, in the environment's frame."""


@once_per_state
def distance(world: World, task: FlagHoisting) -> Tensor:
    """(N,) metres between the flag's corner and its place."""
    return vector_norm(task.goal - corner(world, task), dim=1)


@once_per_state
def spread(world: World, task: FlagHoisting) -> Tensor:
    """(N,) in [0, 1]: the flag's area as seen from the side from which it looks largest; folds take from it."""
    return (
        vector_norm(matter.vector_area(world.deformables[CLOTH].positions, task.triangles)[:, :2], dim=1) / task.size**2
    )


def tracking(world: World, task: FlagHoisting, scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the corner is to its place."""
    return common.nearness(distance(world, task), scale)


def at_staff(height: float):
    """Term: (N, 7) the hand around the staff's middle, its frame at a height in the environment."""

    def pose(world: World, task: FlagHoisting) -> Tensor:
        staff = world.objects[STAFF].root_pose
        yaw = 2.0 * torch.atan2(staff[:, 6], staff[:, 3])
        position = torch.cat((staff[:, :2], torch.full_like(staff[:, :1], height)), dim=1)
        return torch.cat((position, common.facing_down(yaw)), dim=1)

    return pose


def at_goal(world: World, task: FlagHoisting) -> Tensor:
    """(N, 7) the hand where the flag's corner comes to its place, as the flag hangs now."""
    return common.pointing_down(task.goal + common.hand_pose(world, task)[:, :3] - corner(world, task))


def sample_goal(world: World, task: FlagHoisting, env_ids: Tensor) -> None:
    """Place the mast up to 4 cm off its place each way, and the corner's place 3 cm before it, 32 to 45 cm up."""
    mast = world.objects[MAST]
    position = torch.tensor(mast.spec.pose.position, device=world.device).repeat(len(env_ids), 1)
    offset = world.random.uniform((3,), (-0.04, -0.04, 0.32), (0.04, 0.04, 0.45), env_ids)
    position[:, :2] += offset[:, :2]
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=world.device).expand(len(env_ids), 4)
    mast.set_root_pose(torch.cat((position, upright), dim=1), env_ids)
    place = torch.stack((position[:, 0] - 0.03, position[:, 1], offset[:, 2]), dim=1)
    task.goal[env_ids] = place
    common.place_markers(world, ("goal",), place[:, None], env_ids)


@dataclass
class FlagHoistingState(cloth.ClothState):
    """The arm's joints and hand, the flag's key points, the last action, the staff and the corner's place."""

    staff: ObservationTerm | None = ObservationTerm(
        lambda world, task: world.objects[STAFF].root_pose, unit=POSE, meaning=Meaning("pose of the staff", ENVIRONMENT)
    )
    goal: ObservationTerm | None = ObservationTerm(
        lambda world, task: task.goal, unit="m", meaning=Meaning("position of the goal", ENVIRONMENT)
    )


@dataclass
class FlagHoistingObservations:
    """Policy and critic see the state."""

    policy: FlagHoistingState = field(default_factory=FlagHoistingState)
    critic: ObservationGroup | None = None


@dataclass
class FlagHoistingRewards(cloth.Smoothness):
    """Rewards of the hand at the staff, the flag spread and its corner in place, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching("back"), 1.0)
    spread: RewardTerm | None = RewardTerm(spread, 10.0)
    track: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.3), 16.0)
    track_finely: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.05), 5.0)


@dataclass
class FlagHoistingEvents:
    """Robot, flag and mast are placed anew for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_flag: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.04, 0.04), 0.3, carrier=STAFF))
    sample_goal: EventTerm | None = EventTerm(sample_goal)


@dataclass(kw_only=True)
class FlagHoisting(cloth.ClothTask):
    """The flag lies flat on a tray, one edge fixed along a staff; it is to hang from it beside a mast.

    Succeeds when the flag's corner is within ``tolerance`` of its place and ``least_spread`` of the flag is seen from
    the side at the episode's end. Metric: that distance.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_AREA, "staff and mast stand at the ends of the workspace: each starts on 1 dm²"),
        TaskException(TaskCheck.START_YAW, "the staff lies along the bench"),
    )
    episode_length: float = 6.0
    view: Pose = look_at(eye=(1.25, -0.95, 0.75), target=(0.5, 0.0, 0.2))
    tolerance: float = 0.03
    """Metres."""
    least_spread: float = 0.8
    observations: FlagHoistingObservations = field(default_factory=FlagHoistingObservations)
    rewards: FlagHoistingRewards = field(default_factory=FlagHoistingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: FlagHoistingEvents = field(default_factory=FlagHoistingEvents)
    goal: Tensor = field(init=False)
    """(N, 3) in the environment's frame."""
    triangles: Tensor = field(init=False)
    """(T, 3) particles of the flag's triangles."""

    def scene(self) -> Scene:
        edge = tuple(range(self.particles * (self.particles - 1), self.particles**2))
        flag = self.cloth((0.45, -0.05, TRAY))
        flag = replace(flag, attachments=(Attachment(edge, STAFF, STAFF),), color=(0.85, 0.65, 0.2, 1.0))
        beside = -0.05 + 0.5 * (self.size + THICK) + flag.thickness
        staff = SolidOptions(mass=0.1, pose=Pose((0.45, beside, TRAY + 0.5 * TALL)), color=(0.72, 0.55, 0.38, 1.0))
        mast = SolidOptions(mass=1.0, fixed_base=True, pose=Pose((0.68, 0.1, 0.25)), color=(0.85, 0.85, 0.85, 1.0))
        return self.on_bench(
            flag,
            cloth.tray((0.4, 0.5, TRAY), 0.45),
            box(STAFF, (self.size + 0.02, THICK, TALL), **staff),
            box(MAST, (0.02, 0.02, 0.5), **mast),
            markers=(MarkerSpec("goal", MarkerShape.SPHERE, size=0.03),),
        )

    def start(self, world: World) -> None:
        super().start(world)
        self.goal = torch.zeros(world.num_envs, 3, device=world.device)
        faces = np.asarray(self.cloth((0.0, 0.0, 0.0)).mesh.faces, dtype=np.int64)
        self.triangles = torch.as_tensor(faces, device=world.device)

    def success(self, world: World) -> Tensor:
        return (distance(world, self) < self.tolerance) & (spread(world, self) >= self.least_spread)

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"corner_distance_m": distance(world, self), "spread": spread(world, self)}

    def expert(self, world: World) -> Expert:
        height = TRAY + CLEAR + cloth.finger_reach(world, closed=True)
        closing = max(0.4, 1.5 * common.closing_time(world))
        phases = (
            Phase(at_staff(height + 0.1), position_tolerance=0.02, free=True),
            Phase(at_staff(height), position_tolerance=0.004, timeout=1.2),
            Phase(at_staff(height), gripper_open=False, dwell=closing, timeout=closing),
            Phase(cloth.here(cloth.CARRIED), gripper_open=False, position_tolerance=0.03, timeout=1.2),
            Phase(at_goal, gripper_open=False),
        )
        return Expert(world, self, phases, position_lead=0.05)
