"""Flag-Hoisting: take a flag by its staff and raise it next to a mast, until it hangs spread at its place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import SolidOptions, box
from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import Attachment, MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY
from orbit_tasks.mdp import matter

STAFF, MAST = "staff", "mast"
# Metres of the staff's section, across and upright.
THICK, TALL = 0.014, 0.03
# Metres that the finger tips keep from the tray as they take the staff.
CLEAR = 0.0105
# The key point that belongs next to the mast: one end of the edge that is on the staff.
CORNER = "corner++"

corner = cloth.key_point(CORNER)
"""(N, 3) the flag's corner, in the environment's frame."""


class FlagMemory(TaskState):
    """State of a flag, looked up once in a new world."""

    triangles: Tensor
    """(T, 3) particles of the flag's triangles."""

    def start(self, env: Environment[FlagHoisting]) -> None:
        faces = np.asarray(env.task.cloth((0.0, 0.0, 0.0)).mesh.faces, dtype=np.int64)
        self.triangles = torch.as_tensor(faces, device=env.device)


@once_per_state
def distance(env: Environment[FlagHoisting]) -> Tensor:
    """(N,) metres between the flag's corner and its place."""
    return vector_norm(env.commands["goal"] - corner(env), dim=1)


@once_per_state
def spread(env: Environment[FlagHoisting, FlagMemory]) -> Tensor:
    """(N,) in [0, 1]: the flag's area as seen from the side from which it looks largest; folds take from it."""
    return (
        vector_norm(matter.vector_area(env.world.deformables[CLOTH].positions, env.state.triangles)[:, :2], dim=1)
        / env.task.size**2
    )


def tracking(env: Environment[FlagHoisting], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the corner is to its place."""
    return common.nearness(distance(env), scale)


def at_staff(height: float):
    """Term: (N, 7) the hand around the staff's middle, its frame at a height in the environment."""

    def pose(env: Environment[FlagHoisting]) -> Tensor:
        staff = env.world.objects[STAFF].root_pose
        # The staff turns about the vertical only as long as it is on the tray.
        yaw = 2.0 * torch.atan2(staff[:, 6], staff[:, 3])
        position = torch.cat((staff[:, :2], torch.full_like(staff[:, :1], height)), dim=1)
        return torch.cat((position, common.facing_down(yaw)), dim=1)

    return pose


def at_goal(env: Environment[FlagHoisting]) -> Tensor:
    """(N, 7) the hand where the flag's corner is at its place, as the flag hangs now."""
    return common.pointing_down(env.commands["goal"] + common.hand_pose(env)[:, :3] - corner(env))


@dataclass(unsafe_hash=True, kw_only=True)
class FlagPlace(UniformPositionCommand):
    """Place of the flag's corner, 3 cm before the mast, which stands up to 4 cm off its place each way."""

    BEFORE: ClassVar[float] = 0.03
    """Metres along x by which the place is nearer to the robot than the mast."""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        x, y, _ = env.world.objects[MAST].spec.pose.position
        return {"x": (x - 0.04, x + 0.04), "y": (y - 0.04, y + 0.04), "z": (0.32, 0.45)}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        return drawn - torch.tensor([self.BEFORE, 0.0, 0.0], device=drawn.device)

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        mast = env.world.objects[MAST]
        pose = torch.tensor([0.0, 0.0, mast.spec.pose.position[2], 1.0, 0.0, 0.0, 0.0], device=env.device)
        pose = pose.repeat(len(command), 1)
        pose[:, 0], pose[:, 1] = command[:, 0] + self.BEFORE, command[:, 1]
        mast.set_root_pose(pose, env_ids)
        super().show(env, command, env_ids)


@dataclass
class FlagHoistingState(cloth.ClothState):
    """The arm's joints and hand, the flag's key points, the last action, the staff and the corner's place."""

    staff: ObservationTerm | None = ObservationTerm(
        lambda env: env.world.objects[STAFF].root_pose, unit=POSE, meaning=Meaning("pose of the staff", ENVIRONMENT)
    )
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"), unit="m", meaning=Meaning("position of the goal", ENVIRONMENT)
    )


@dataclass
class FlagHoistingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: FlagHoistingState = field(default_factory=FlagHoistingState)
    critic: ObservationGroup | None = None


@dataclass
class FlagHoistingRewards(cloth.Smoothness):
    """Rewards of the hand at the staff, the flag spread and its corner in place, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching("back"), 1.0)
    spread: RewardTerm | None = RewardTerm(spread, 10.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the flag's corner to its place, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""


@dataclass
class FlagHoistingCommands:
    """The place of the flag's corner, and the mast with it."""

    goal: CommandTerm | None = FlagPlace(marker="goal")


@dataclass
class FlagHoistingEvents:
    """Robot and flag are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_flag: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.04, 0.04), 0.3, carrier=STAFF))


@dataclass(kw_only=True)
class FlagHoisting(cloth.ClothTask):
    """The flag is flat on a tray, one edge fixed along a staff; it is to hang from it next to a mast.

    Succeeds when the flag's corner is within ``tolerance`` of its place and ``least_spread`` of the flag is seen from
    the side at the episode's end. Metric: that distance.
    """

    state_type: ClassVar[type[TaskState]] = FlagMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = replace(
        cloth.ClothTask.metadata,
        view=look_at(eye=(1.25, -0.95, 0.75), target=(0.5, 0.0, 0.2)),
        exceptions=(
            TaskException(
                TaskCheck.START_AREA, "staff and mast stand at the ends of the workspace: each starts on 1 dm²"
            ),
            TaskException(TaskCheck.START_YAW, "the staff lies along the bench"),
        ),
    )
    episode_length: float = 6.0
    tolerance: float = 0.03
    """Metres."""
    least_spread: float = 0.8
    observations: FlagHoistingObservations = field(default_factory=FlagHoistingObservations)
    rewards: FlagHoistingRewards = field(default_factory=FlagHoistingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: FlagHoistingEvents = field(default_factory=FlagHoistingEvents)
    commands: FlagHoistingCommands = field(default_factory=FlagHoistingCommands)

    def scene(self) -> Scene:
        # The last row of the grid of particles, which is numbered row by row.
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

    def success(self, env: Environment) -> Tensor:
        return (distance(env) < self.tolerance) & (spread(env) >= self.least_spread)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"corner_distance_m": distance(env), "spread": spread(env)}

    def expert(self, env: Environment) -> Expert:
        height = TRAY + CLEAR + cloth.finger_reach(env.world, closed=True)
        closing = max(0.4, 1.5 * common.closing_time(env.world))
        phases = (
            Phase(at_staff(height + 0.1), position_tolerance=0.02, free=True),
            Phase(at_staff(height), position_tolerance=0.004, timeout=1.2),
            # Fingers that are still closing would lift without the staff.
            Phase(at_staff(height), gripper_open=False, dwell=closing, timeout=closing),
            Phase(cloth.here(cloth.CARRIED), gripper_open=False, position_tolerance=0.03, timeout=1.2),
            Phase(at_goal, gripper_open=False),
        )
        return Expert(env, phases, position_lead=0.05)
