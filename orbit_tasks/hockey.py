"""Hockey: hit a puck with a stick into the net, over ice."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vecdot, vector_norm

from orbit_assets.objects import BENCH_HEIGHT, BLADE_HALF, box, cylinder, net, stick, table
from orbit_assets.objects import HOCKEY_WHITE as WHITE
from orbit_assets.objects import NET_DEPTH as DEPTH
from orbit_assets.objects import NET_WIDTH as WIDTH
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, PremiseTerm, RewardTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import Meaning, TermFunction, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import PhysicsMaterial, Pose, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import held, premises, tabletop

ICE = PhysicsMaterial(0.04, 0.04)
# Metres, of the ice on the table.
THICKNESS = 0.01
# Metres, of the puck.
RADIUS, HEIGHT = 0.03, 0.02
# Metres above the table at which the blade's middle strikes.
STRIKE = THICKNESS + BLADE_HALF[2] + 0.005


class HockeyMemory(tabletop.TabletopMemory):
    """State of the net on its way, and the puck's least distance to it."""

    net_middle: Tensor = buffer()
    """(N,) metres, where the net is in the middle of its way."""
    net_phase: Tensor = buffer()
    """(N,) rad, where on its way it starts."""
    nearest: Tensor = buffer(initial=torch.inf)
    """(N,) metres, the shortest distance in the episode."""

    def update(self, env: Environment[Hockey]) -> None:
        # The least of the episode, because a puck that bounces out again was nearer before.
        self.nearest.copy_(torch.minimum(self.nearest, distance(env)))
        position, velocity = net_at(env, env.step_dt)
        env.world.robots["net"].set_position_targets(position[:, None])
        env.world.robots["net"].set_velocity_targets(velocity[:, None])


def net_at(env: Environment[Hockey, HockeyMemory], seconds: Tensor | float) -> tuple[Tensor, Tensor]:
    """(N,) metres and (N,) m/s: place and velocity of the net, so many seconds from now."""
    amplitude, rate = (0.08 if env.task.moving_goal else 0.0), 0.5 * math.pi
    # By the episode's own steps, so that a snapshot or a reset moves the net with them.
    time = env.state.episode_step * env.step_dt + seconds
    angle = env.state.net_phase + rate * time
    return env.state.net_middle + amplitude * angle.sin(), amplitude * rate * angle.cos()


def puck_position(env: Environment[Hockey]) -> Tensor:
    """(N, 3) position of the puck in the environment's frame."""
    return env.world.objects["puck"].root_pose[:, :3]


def puck_velocity(env: Environment[Hockey]) -> Tensor:
    """(N, 3) m/s velocity of the puck in the environment's frame."""
    return env.world.objects["puck"].root_velocity[:, :3]


@once_per_state
def net_position(env: Environment[Hockey]) -> Tensor:
    """(N, 3) of the middle of the net's line, on the ice."""
    return env.world.robots["net"].frame_pose("net")[:, :3]


@once_per_state
def puck_to_inside(env: Environment[Hockey]) -> Tensor:
    """(N, 3) the shortest way on the ice on which the whole puck comes behind the line, between the posts."""
    puck, line = puck_position(env), net_position(env)
    aside = 0.5 * WIDTH - RADIUS
    # Less a radius at the line and the sides: the whole puck must be inside.
    x = puck[:, 0].clamp(line[:, 0] + RADIUS, line[:, 0] + DEPTH)
    y = torch.clamp(puck[:, 1], line[:, 1] - aside, line[:, 1] + aside)
    return torch.stack((x, y, puck[:, 2]), dim=1) - puck


@once_per_state
def distance(env: Environment[Hockey]) -> Tensor:
    """(N,) metres from the puck to the net's inside."""
    return vector_norm(puck_to_inside(env), dim=1)


@once_per_state
def inside(env: Environment[Hockey]) -> Tensor:
    """(N,) bool"""
    return distance(env) < 1e-3


def blade_to_puck(env: Environment[Hockey]) -> Tensor:
    """(N, 3) position of the puck minus the blade's, in the environment's axes."""
    return puck_position(env) - common.hand_pose(env)[:, :3]


@once_per_state
def aim(env: Environment[Hockey]) -> Tensor:
    """(N, 3) unit vector from the puck to the middle of the net, where that will be when the puck comes there."""
    puck, line = puck_position(env), net_position(env)
    seconds = (line[:, 0] - puck[:, 0]).clamp_min(0.0) / 0.6
    # In the net the middle is near, and the direction would swing round: as if it were further.
    ahead = (line[:, 0] + 0.5 * DEPTH - puck[:, 0]).clamp_min(0.15)
    way = torch.stack((ahead, net_at(env, seconds)[0] - puck[:, 1], torch.zeros_like(ahead)), dim=1)
    return way / vector_norm(way, dim=1, keepdim=True)


def striking(env: Environment[Hockey]) -> Tensor:
    """(N,) in [0, 1]: how near the blade is to behind the puck; 1 once the puck is inside."""
    way = behind(0.05, STRIKE)(env)[:, :3] - common.hand_pose(env)[:, :3]
    # 1 inside, or the blade would have to follow the puck into the net.
    return torch.maximum(common.nearness(vector_norm(way, dim=1), 0.15), inside(env).float())


def sliding(env: Environment[Hockey]) -> Tensor:
    """(N,) in [0, 1]: metres a second, at most one, at which the puck goes where it should; 1 once it is inside."""
    speed = vecdot(puck_velocity(env), aim(env)).clamp(0.0, 1.0)
    # 1 inside, or a puck at rest in the net would earn less than one on its way.
    return torch.maximum(speed, inside(env).float())


def place_net(env: Environment[Hockey, HockeyMemory], env_ids: Tensor) -> None:
    """Up to 10 cm off the middle; where it moves, anywhere on its way."""
    place = env.world.random.uniform((2,), (-0.1, 0.0), (0.1, 2.0 * math.pi), env_ids)
    env.state.net_middle[env_ids], env.state.net_phase[env_ids] = place[:, 0], place[:, 1]
    position, velocity = (value[env_ids, None] for value in net_at(env, 0.0))
    env.world.robots["net"].set_joint_state(position, velocity, env_ids=env_ids)


def place_puck(env: Environment[Hockey], env_ids: Tensor) -> None:
    """Place the puck on an 8 x 24 cm patch at the near side of the hand's workspace."""
    near = common.workspace(env.world)[0][0]
    low, high = (near + 0.02, -0.12, THICKNESS + 0.5 * HEIGHT), (near + 0.1, 0.12, THICKNESS + 0.5 * HEIGHT)
    position = env.world.random.uniform((3,), low, high, env_ids)
    upright = common.turned(torch.zeros_like(position[:, 0]))
    env.world.objects["puck"].set_root_pose(torch.cat((position, upright), dim=1), env_ids)


def behind(back: float, height: float) -> TermFunction:
    """(N, 7) the blade across the way to the net, ``back`` metres behind the puck, ``height`` above the table."""

    def target(env: Environment[Hockey]) -> Tensor:
        position = puck_position(env) - back * aim(env)
        return _facing(env, position, height)

    return target


def follow_through(env: Environment[Hockey]) -> Tensor:
    """(N, 7) the blade well beyond the puck on its way to the net, but 3 cm behind the line at most."""
    position = puck_position(env) + 0.15 * aim(env)
    # Not further than just beyond the line, where the stick would hit the net.
    limit = net_position(env)[:, 0] + 0.03
    return _facing(env, torch.cat((torch.minimum(position[:, 0], limit)[:, None], position[:, 1:]), 1), STRIKE)


def _facing(env: Environment[Hockey], position: Tensor, height: float) -> Tensor:
    way = aim(env)
    at = torch.cat((position[:, :2], torch.full_like(position[:, :1], height)), dim=1)
    return torch.cat((at, common.facing_down(torch.atan2(way[:, 1], way[:, 0]).clamp(-0.8, 0.8))), dim=1)


@dataclass
class HockeyState(ObservationGroup):
    """The arm's joints and the blade, the puck, its way into the net, the net and its velocity, the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    blade_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    puck_position: ObservationTerm | None = ObservationTerm(puck_position, unit="m")
    puck_velocity: ObservationTerm | None = ObservationTerm(puck_velocity, unit="m/s")
    blade_to_puck: ObservationTerm | None = ObservationTerm(blade_to_puck, unit="m")
    puck_to_inside: ObservationTerm | None = ObservationTerm(puck_to_inside, unit="m")
    net_position: ObservationTerm | None = ObservationTerm(net_position, unit="m")
    net_velocity: ObservationTerm | None = ObservationTerm(
        lambda env: env.world.robots["net"].joint_velocities,
        unit="m/s",
        meaning=Meaning("measured velocity of the net along its rail"),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class HockeyRewards:
    """Rewards of the blade behind the puck, of the puck on its way and in the net, less what is fast or abrupt."""

    strike: RewardTerm | None = RewardTerm(striking, 1.0)
    slide: RewardTerm | None = RewardTerm(sliding, 4.0)
    near: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.3), 8.0)
    """Nearness of the puck to the inside of the net, within some 0.3 m."""
    score: RewardTerm | None = RewardTerm(lambda env: inside(env).float(), 16.0)
    """1 in each step in which the puck is in the net."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class HockeyEvents(tabletop.ArmEvents):
    """Robot, net and puck are placed for each episode; friction and the like with domain randomisation."""

    place_net: EventTerm | None = EventTerm(place_net)
    place_puck: EventTerm | None = EventTerm(place_puck)


@dataclass
class HockeyPremises:
    """The puck is still on the ice, and outside of the net."""

    still: PremiseTerm | None = PremiseTerm(
        lambda env: premises.standing(env.world, ("puck",), THICKNESS + 0.5 * HEIGHT),
        "the puck does not lie still and flat on the ice, so that it began inside another thing, or slid away",
    )
    outside: PremiseTerm | None = PremiseTerm(lambda env: ~inside(env), "the puck is in the net already")


@dataclass(kw_only=True)
class Hockey(tabletop.TabletopTask):
    """The hand holds a stick for good. The puck is before it on ice, the net stands at the end of its reach.

    Succeeds when the whole puck is in the net at the episode's end. Metric: the shortest distance in the episode from
    the puck to the net's inside.
    """

    state_type: ClassVar[type[TaskState]] = HockeyMemory
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=800, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(1.5, 1.0, 0.85), target=(0.5, 0.0, 0.1)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the puck starts on 8 x 24 cm, where the stick gets behind it"),
            TaskException(TaskCheck.START_YAW, "a puck is round"),
        ),
    )
    episode_length: float = 5.0
    moving_goal: bool = False
    """Whether the net slides to and fro, 8 cm either way in 4 s."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(HockeyState))
    rewards: HockeyRewards = field(default_factory=HockeyRewards)
    terminations: tabletop.DropTerminations = field(default_factory=tabletop.DropTerminations)
    events: HockeyEvents = field(default_factory=HockeyEvents)
    premises: HockeyPremises = field(default_factory=HockeyPremises)

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("puck",)

    def scene(self) -> Scene:
        robot = held.with_tool(task_robots.arm(self.robot, gripper=False), stick(), "blade")
        near, line = common.workspace_of(robot).low[0], common.workspace_of(robot).high[0] + 0.08
        end = line + DEPTH + 0.05
        ice = (end - near + 0.1, 1.0, THICKNESS)
        middle = Pose((0.5 * (end + near - 0.1), 0.0, 0.5 * THICKNESS))
        puck = Pose((near + 0.06, 0.0, THICKNESS + 0.5 * HEIGHT))
        return Scene(
            robots=(robot, net(Pose((line, 0.0, THICKNESS)))),
            objects=(
                cylinder("puck", RADIUS, HEIGHT, mass=0.1, color=(0.05, 0.05, 0.05, 1.0), material=ICE, pose=puck),
                box("ice", ice, color=WHITE, material=ICE, fixed_base=True, pose=middle),
                table("table", size=(end + 0.35, 1.4, BENCH_HEIGHT), pose=Pose((0.5 * (end - 0.25), 0.0, 0.0))),
            ),
            terrain=(common.floor(-BENCH_HEIGHT),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The friction of puck and ice, the arm's gains, and noise on joints and puck."""
        self.vary(("puck", "ice"), (0.02, 0.08), puck_position=0.002)

    def success(self, env: Environment) -> Tensor:
        return inside(env)

    def metrics(self, env: Environment[Any, HockeyMemory]) -> dict[str, Tensor]:
        return {"distance_m": env.state.nearest}

    def expert(self, env: Environment) -> Expert:
        phases = (
            Phase(behind(0.1, 0.15), position_tolerance=0.03, timeout=2.0, free=True),
            Phase(behind(0.08, STRIKE), position_tolerance=0.01, timeout=1.5),
            Phase(follow_through),
        )
        return Expert(env, phases)
