"""Mobile-Cabinet: drive to a cabinet and pull its drawer open by the handle."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from torch import Tensor

from orbit_core.envs import Environment, EventTerm, ObservationTerm, RewardTerm, TerminationTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskMetadata
from orbit_core.mdp import common
from orbit_core.scene import Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cabinet
from orbit_tasks.cabinet import (
    Cabinet,
    CabinetEvents,
    CabinetMemory,
    CabinetObservations,
    CabinetRewards,
    CabinetState,
    CabinetTerminations,
    handle_pose,
)
from orbit_tasks.mobile import (
    Mobile,
    ahead_of,
    base_pose,
    mobile,
    near_to,
    over_floor,
    sag_rate,
    start_within,
    tipped,
)

# Height in metres of the lowest place that an arm on a bench is asked to reach, above its own foot.
BENCH_ARM = 0.15


class MobileCabinetMemory(CabinetMemory):
    """State of a cabinet before a moving base, looked up once in a new world."""

    away: float
    """Metres from the base to the cabinet's middle where the expert opens it."""

    def start(self, env: Environment) -> None:
        super().start(env)
        self.away = cabinet.distance_to_cabinet(common.robot_of(env.world).spec)


def before_cabinet(env: Environment[MobileCabinet, MobileCabinetMemory]) -> Tensor:
    """(N, 3) the base as far before the cabinet as an arm on a bench stands."""
    return ahead_of(over_floor(env.world.objects["cabinet"].root_pose), env.state.away)


@dataclass
class MobileCabinetState(CabinetState):
    """State of Cabinet, and the base's pose."""

    base_pose: ObservationTerm | None = ObservationTerm(base_pose)


@dataclass
class MobileCabinetObservations(CabinetObservations):
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: CabinetState = field(default_factory=MobileCabinetState)


@dataclass
class MobileCabinetRewards(CabinetRewards):
    """Rewards of Cabinet, and one that grows over the metres that the base drives."""

    approach: RewardTerm | None = RewardTerm(near_to(handle_pose, 1.0), 1.0)


@dataclass
class MobileCabinetTerminations(CabinetTerminations):
    """An episode ends early where the base falls over."""

    tipped: TerminationTerm | None = TerminationTerm(tipped)


@dataclass
class MobileCabinetEvents(CabinetEvents):
    """Events of Cabinet; the base starts anywhere before the cabinet, out of the arm's reach, facing anywhere."""

    place_robot: EventTerm | None = EventTerm(start_within((-2.0, -1.0), (-0.8, 1.0)))


@dataclass(kw_only=True)
class MobileCabinet(Mobile, Cabinet):
    """Variant of Cabinet, from 0.8 to 2 m farther off, up to 1 m to the side, and facing anywhere.

    The cabinet is raised until the robot's arm is to it what one on a bench is to a cabinet on its plinth.
    """

    episode_length: float = 16.0
    state_type: ClassVar[type[TaskState]] = MobileCabinetMemory
    metadata: TaskMetadata = replace(
        Cabinet.metadata,
        view=look_at(eye=(-1.6, 3.0, 2.2), target=(0.0, 0.0, 0.5)),
    )
    observations: CabinetObservations = field(default_factory=MobileCabinetObservations)
    rewards: CabinetRewards = field(default_factory=MobileCabinetRewards)
    terminations: CabinetTerminations = field(default_factory=MobileCabinetTerminations)
    events: CabinetEvents = field(default_factory=MobileCabinetEvents)

    def scene(self) -> Scene:
        robot = mobile(self.robot)
        lowest = common.placed_workspace(robot).low[2]
        scene = self.scene_with(robot, cabinet.PLINTH + max(0.0, lowest - BENCH_ARM))
        return self.in_surroundings(replace(scene, firm_friction=bool(robot.feet)))

    def expert(self, env: Environment) -> Expert:
        # Tight: the arm opens the drawer from here, and its handle must stay within reach.
        drive = Phase(base=before_cabinet, position_tolerance=0.03, rotation_tolerance=0.05, timeout=12.0)
        return Expert(
            env,
            (drive, *cabinet.PULLING),
            position_lead=cabinet.POSITION_LEAD,
            rotation_lead=cabinet.ROTATION_LEAD,
            sag_rate=sag_rate(env.world),
        )
