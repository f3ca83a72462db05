"""Beat-The-Buzz: lead a ring along a bent rod without touching it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vecdot, vector_norm

from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_assets.pegs import Course, bent_rod, ring_on_handle, spline
from orbit_core.dynamics.transforms import (
    pose_inverse,
    pose_multiply,
    quat_from_matrix,
    quat_rotate,
    quat_rotate_inverse,
)
from orbit_core.envs import (
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    PremiseTerm,
    RewardTerm,
    Task,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import Meaning, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common, randomize
from orbit_core.scene import ContactSensorSpec, Pose, Scene, look_at
from orbit_core.sensors import ContactSensor
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import held

ROD, RING, TOUCH = "rod", "ring", "touch"
# Metres of the rod's ends above the table.
HEIGHT = 0.2
# Metres, radius of the rod and of the ring's bars.
THICKNESS, BAR = 0.006, 0.004
# Metres from the hand to the ring's middle, and from there to the middle of its bars.
REACH, RADIUS = 0.14, 0.035
# Metres between the course's points; points to a capsule of the rod; metres of the rod at either end left out.
SPACING, EVERY, MARGIN = 0.005, 4, 0.05
# Metres ahead of where the ring is that a reward and the expert look to.
AHEAD = 0.03
# Newtons, that count as a touch.
LEAST_FORCE = 1e-3
# Metres forward and up of corners that the rod is bent through, on even steps along 0.4 m from left to right.
BENDS: Mapping[str, Sequence[tuple[float, float]]] = {
    "easy": ((0.0, 0.0), (0.0, 0.03), (0.0, 0.0), (0.0, -0.03), (0.0, 0.0)),
    "medium": ((0.0, 0.0), (0.03, 0.04), (0.0, 0.0), (-0.03, -0.04), (0.0, 0.0)),
    "hard": ((0.0, 0.0), (0.02, 0.03), (-0.02, 0.0), (0.02, -0.03), (-0.02, 0.0), (0.02, 0.03), (0.0, 0.0)),
}


def course_of(rod: str) -> Course:
    """The whole rod's course about its middle.

    Raises:
        ConfigurationError: there is no such rod.
    """
    if rod not in BENDS:
        raise ConfigurationError(f"no rod is called '{rod}': choose one of {', '.join(BENDS)} as the rod")
    bends = BENDS[rod]
    step = 0.4 / (len(bends) - 1)
    return spline([(x, 0.2 - step * index, z) for index, (x, z) in enumerate(bends)], SPACING)


def rings_along(course: Course) -> Tensor:
    """(K, 7) the ring around each point of a course: across the tangent, the handle as upright as can be."""
    point, tangent = (torch.tensor(values, dtype=torch.float32) for values in (course.points, course.tangents))
    down = torch.zeros_like(tangent)
    down[:, 2] = -1.0
    z = down - vecdot(down, tangent)[:, None] * tangent
    z = z / vector_norm(z, dim=1, keepdim=True)
    matrix = torch.stack((torch.linalg.cross(tangent, z), tangent, z), dim=2)
    return torch.cat((point, quat_from_matrix(matrix)), dim=1)


class BuzzMemory(TaskState):
    """State of a ring: the part of the rod that it covered, its touches, and the course."""

    rings: Tensor
    """(K, 7) of the ring along the rod's part that is to be covered, in the rod's frame."""
    spacing: float
    """Metres along the rod from a point to the next."""
    covered: Tensor = buffer()
    """(N,) metres of it."""
    gained: Tensor = buffer()
    """(N,) m/s, at which it was covered in this step."""
    touches: Tensor = buffer()
    """(N,) how often the ring began to touch the rod."""
    touched: Tensor = buffer(dtype=torch.bool)
    """(N,) bool: it did in the step before."""

    def start(self, env: Environment[BeatTheBuzz]) -> None:
        course = course_of(env.task.rod).part(MARGIN)
        self.rings = rings_along(course).to(env.device)
        self.spacing = course.spacing

    def update(self, env: Environment[BeatTheBuzz]) -> None:
        now = touching(env)
        # Beginnings are counted: one long touch is one.
        self.touches += (now & ~self.touched).float()
        self.touched.copy_(now)
        ring = pose_multiply(pose_inverse(env.world.objects[ROD].root_pose), common.hand_pose(env))
        places = torch.arange(len(self.rings), device=env.device) * self.spacing
        # Only near the present place: elsewhere the rod may be as near to the ring, which is not around it there.
        far = (places - self.covered[:, None]).abs() > 0.05
        nearest = vector_norm(ring[:, None, :3] - self.rings[:, :3], dim=2).masked_fill(far, torch.inf).argmin(1)
        # Never less, so that going back and forth earns nothing twice.
        covered = torch.maximum(self.covered, places[nearest])
        self.gained.copy_((covered - self.covered) / env.step_dt)
        self.covered.copy_(covered)


def finished(env: Environment[BeatTheBuzz, BuzzMemory]) -> Tensor:
    """(N,) bool: the whole rod is covered, to a centimetre."""
    return env.state.covered > (len(env.state.rings) - 1) * env.state.spacing - 0.01


def ahead(env: Environment[BeatTheBuzz, BuzzMemory], way: float = AHEAD) -> Tensor:
    """(N, 7) of the ring ``way`` metres ahead of where it is on the rod, at most at its end."""
    index = ((env.state.covered + way) / env.state.spacing).round().long().clamp(max=len(env.state.rings) - 1)
    return pose_multiply(env.world.objects[ROD].root_pose, env.state.rings[index])


def at_rod(env: Environment[BeatTheBuzz]) -> Tensor:
    """(N, 7) of the ring where it should be now."""
    return ahead(env, 0.0)


@once_per_state
def offset(env: Environment[BeatTheBuzz]) -> Tensor:
    """(N, 3) in the ring's axes: from its middle to the rod's middle line, where it is."""
    ring = common.hand_pose(env)
    return quat_rotate_inverse(ring[:, 3:], at_rod(env)[:, :3] - ring[:, :3])


@once_per_state
def way_ahead(env: Environment[BeatTheBuzz]) -> Tensor:
    """(N, 6) in the ring's axes: from its middle to where it should come next, and the rod's direction there."""
    ring, target = common.hand_pose(env), ahead(env)
    tangent = quat_rotate(target[:, 3:], torch.eye(3, device=env.device)[1].expand(env.num_envs, 3))
    parts = (target[:, :3] - ring[:, :3], tangent)
    return torch.cat([quat_rotate_inverse(ring[:, 3:], part) for part in parts], dim=1)


def covered(env: Environment[BeatTheBuzz, BuzzMemory]) -> Tensor:
    """(N, 1) metres of the rod covered."""
    return env.state.covered[:, None]


def centred(env: Environment[BeatTheBuzz]) -> Tensor:
    """(N,) in [0, 1]: how near the rod is to the ring's middle, and the ring to standing across it."""
    return common.nearness(vector_norm(offset(env), dim=1), 0.02) * way_ahead(env)[:, 4].clamp_min(0.0)


@once_per_state
def touching(env: Environment[BeatTheBuzz]) -> Tensor:
    """(N,) bool: the ring touched the rod in this step."""
    sensor = env.world.sensors[TOUCH]
    assert isinstance(sensor, ContactSensor)
    return (vector_norm(sensor.filtered_forces, dim=-1) > LEAST_FORCE).flatten(1).any(1)


def place_rod(env: Environment[BeatTheBuzz], env_ids: Tensor) -> None:
    """Up to 8 mm off its place, each way: the ring stays around it."""
    low, high = (
        (*(value + way for value in env.world.objects[ROD].spec.pose.position), 0.0) for way in (-0.008, 0.008)
    )
    env.world.objects[ROD].set_root_pose(common.standing(env.world.random.uniform((4,), low, high, env_ids)), env_ids)


@dataclass
class BuzzState(ObservationGroup):
    """The arm's joints and the ring, the rod through it and ahead of it, what is covered, touch, the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    ring_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    offset: ObservationTerm | None = ObservationTerm(offset, unit="m")
    way_ahead: ObservationTerm | None = ObservationTerm(way_ahead, unit="m")
    covered: ObservationTerm | None = ObservationTerm(covered, unit="m")
    touching: ObservationTerm | None = ObservationTerm(
        lambda env: touching(env).float()[:, None],
        unit="1",
        meaning=Meaning("1 where the ring touches the wire, else 0"),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class BuzzObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: BuzzState = field(default_factory=BuzzState)
    critic: ObservationGroup | None = None


@dataclass
class BuzzRewards:
    """Rewards of the ring about the middle of the rod and on its way along it, less touches and what is abrupt."""

    centre: RewardTerm | None = RewardTerm(centred, 1.0)
    advance: RewardTerm | None = RewardTerm(lambda env: env.state.gained, 20.0)
    """m/s at which the ring comes to parts of the rod where it has not been yet."""
    done: RewardTerm | None = RewardTerm(lambda env: finished(env).float(), 8.0)
    """1 in each step from the time that the ring has come to the rod's other end."""
    touch: RewardTerm | None = RewardTerm(lambda env: touching(env).float(), -4.0)
    """Penalty of each step in which the ring touches the rod."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class BuzzTerminations:
    """Only the time limit ends an episode."""


@dataclass
class BuzzEvents:
    """Robot and rod are placed for each episode; the arm's gains with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.005))
    place_rod: EventTerm | None = EventTerm(place_rod)
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping, drawn for each environment; set by domain randomisation."""


@dataclass
class BuzzPremises:
    """The ring is around the rod, and free of it."""

    free: PremiseTerm | None = PremiseTerm(
        lambda env: vector_norm(offset(env), dim=1) < RADIUS - BAR - THICKNESS,
        "the ring touches the rod, or is not around it",
    )


@dataclass(kw_only=True)
class BeatTheBuzz(Task):
    """The hand holds a ring for good, which is around one end of a bent rod, and leads it to the other.

    Succeeds when the whole rod is covered and the ring has not touched it in the episode. Metric: metres of the rod
    covered, less ``penalty`` for each touch.
    """

    state_type: ClassVar[type[TaskState]] = BuzzMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="lead the ring along the wire without touching it",
        ppo=PpoSettings(iterations=800, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(1.35, 0.5, 0.6), target=(0.5, 0.0, 0.25)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the rod fills the workspace, for all of it must be in reach"),
            TaskException(TaskCheck.START_YAW, "the ring goes along the rod with a level hand in one direction only"),
        ),
    )
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 6.0
    rod: str = "easy"
    """How the rod is bent: easy (up and down), medium (forward and back as well) or hard (in shorter bends)."""
    penalty: float = 0.05
    """Metres, taken from the metric for each touch."""
    observations: BuzzObservations = field(default_factory=BuzzObservations)
    rewards: BuzzRewards = field(default_factory=BuzzRewards)
    terminations: BuzzTerminations = field(default_factory=BuzzTerminations)
    events: BuzzEvents = field(default_factory=BuzzEvents)
    premises: BuzzPremises = field(default_factory=BuzzPremises)

    def scene(self) -> Scene:
        self.bound(penalty=(0.0, 1e3))
        ring = ring_on_handle(RING, RADIUS, BAR, REACH)
        robot = held.with_tool(task_robots.arm(self.robot, gripper=False), ring, f"{RING}_middle")
        box = common.placed_workspace(robot)
        course = course_of(self.rod)
        place = (0.5 * (box.low[0] + box.high[0]), 0.5 * (box.low[1] + box.high[1]), HEIGHT)
        start = rings_along(course.part(MARGIN))[0]
        start[:3] += torch.tensor(place)
        return Scene(
            robots=(held.starting_at(robot, start),),
            objects=(bent_rod(ROD, course, THICKNESS, EVERY, Pose(place)), work_bench()),
            sensors=(ContactSensorSpec(name=TOUCH, entity=ROD, filters=(common.ROBOT,)),),
            terrain=(common.floor(-BENCH_HEIGHT),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The arm's gains, and noise on joints and on where the rod is."""
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        noise = {"joint_positions": 0.005, "joint_velocities": 0.05, "offset": 0.001, "way_ahead": 0.001}
        common.add_noise(self.observations.policy, **noise)

    def success(self, env: Environment[Any, BuzzMemory]) -> Tensor:
        return finished(env) & (env.state.touches == 0.0)

    def metrics(self, env: Environment[Any, BuzzMemory]) -> dict[str, Tensor]:
        return {"covered_m": env.state.covered - self.penalty * env.state.touches, "touches": env.state.touches}

    def expert(self, env: Environment) -> Expert:
        return Expert(env, (Phase(ahead),), position_lead=0.05, straight=True)
