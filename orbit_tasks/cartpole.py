"""Cartpole-Balance and Cartpole-Swing-Up: a motor pushes a cart, on which a pole must stand.

The expert of both is the energy control of Åström and Furuta, Swinging Up a Pendulum by Energy Control (2000), and near
the top a linear-quadratic regulator of the linearised equations of motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_assets.catalogue import robot
from orbit_core.actions import ActionTerms, JointEffortConfig
from orbit_core.actions.joints import JointEffort
from orbit_core.envs import (
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import measured_in, once_per_state
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import RobotSpec, Scene, look_at

SLIDER, HINGE = "slider", "hinge"
# N, of the motor.
STRONGEST = 20.0
# rad from the top within which the regulator takes over, where the energy is right.
_CATCH = 0.4
# Of the regulator: squared state (cart, pole and their velocities) and squared force.
_WEIGHTS = (1.0, 10.0, 0.5, 0.5), 0.01


def cartpole(name: str) -> RobotSpec:
    """A robot of the catalogue with the joints ``slider`` and ``hinge``, as the task's robot.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it is no cart with a pole.
    """
    spec = robot(name, name=common.ROBOT)
    if spec.articulation.joint_names != (SLIDER, HINGE):
        raise ConfigurationError(
            f"robot '{name}' has not the joints '{SLIDER}' and '{HINGE}' alone, which this task needs: choose cartpole"
        )
    return spec


class CartpoleMemory(TaskState):
    """State of cart and pole, looked up once in a new world."""

    rail: float
    """m, on either side of the middle."""

    def start(self, env: Environment) -> None:
        self.rail = float(common.robot_of(env.world).position_limits[0, 1])


@measured_in("m, rad, m/s, rad/s")
@once_per_state
def state(env: Environment[Cartpole]) -> Tensor:
    """(N, 4) where the cart is, the pole's angle from the vertical in [-pi, pi], and how fast both change."""
    body = common.robot_of(env.world)
    cart, angle = body.joint_positions.unbind(1)
    # The hinge turns without end: its angle is brought back into one turn.
    return torch.cat((torch.stack((cart, torch.atan2(angle.sin(), angle.cos())), 1), body.joint_velocities), 1)


@measured_in("m, 1, 1, m/s, rad/s")
def seen(env: Environment[Cartpole]) -> Tensor:
    """(N, 5) the cart, cosine and sine of the pole's angle, and both velocities."""
    cart, angle, speed, rate = state(env).unbind(1)
    return torch.stack((cart, angle.cos(), angle.sin(), speed, rate), 1)


def upright(env: Environment[Cartpole]) -> Tensor:
    """(N,) in [0, 1]: 1 where the pole stands, 0 where it hangs."""
    return 0.5 + 0.5 * state(env)[:, 1].cos()


def off_center(env: Environment[Cartpole]) -> Tensor:
    """(N,) m², squared distance of the cart from the middle."""
    return state(env)[:, 0].square()


def spinning(env: Environment[Cartpole]) -> Tensor:
    """(N,) squared rate of the pole."""
    return state(env)[:, 3].square()


@once_per_state
def left(env: Environment[Cartpole, CartpoleMemory]) -> Tensor:
    """(N,) bool: the cart is 10 cm from an end of its rail."""
    return state(env)[:, 0].abs() > env.state.rail - 0.1


def toppled(env: Environment[CartpoleBalance]) -> Tensor:
    """(N,) bool: the pole leans by more than the task allows."""
    return state(env)[:, 1].abs() > env.task.most_lean


def place(env: Environment[Cartpole], env_ids: Tensor) -> None:
    """Cart, pole and their velocities, uniform within the task's ``spread`` of its start."""
    body = common.robot_of(env.world)
    high = torch.tensor(env.task.spread, device=env.device)
    drawn = env.world.random.uniform((4,), -high, high, env_ids)
    start = torch.tensor((0.0, env.task.start_angle), device=env.device)
    body.set_joint_state(start + drawn[:, :2], drawn[:, 2:], env_ids=env_ids)


@dataclass
class CartpoleState(ObservationGroup):
    """Cart and pole, and the last action."""

    state: ObservationTerm | None = ObservationTerm(seen)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class CartpoleObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: CartpoleState = field(default_factory=CartpoleState)
    critic: ObservationGroup | None = None


@dataclass
class CartpoleRewards:
    """Rewards of a pole that stands, less distance from the middle, spinning and force."""

    upright: RewardTerm | None = RewardTerm(upright, 2.0)
    off_center: RewardTerm | None = RewardTerm(off_center, -0.2)
    spinning: RewardTerm | None = RewardTerm(spinning, -0.01)
    force: RewardTerm | None = RewardTerm(common.action_size, -0.01)


@dataclass
class SwingUpTerminations:
    """An episode ends early where the cart reaches the rail's end."""

    left: TerminationTerm | None = TerminationTerm(left)


@dataclass
class BalanceTerminations(SwingUpTerminations):
    """And where the pole topples."""

    toppled: TerminationTerm | None = TerminationTerm(toppled)


@dataclass
class CartpoleEvents:
    """Cart and pole are placed for each episode; masses with domain randomisation."""

    place: EventTerm | None = EventTerm(place)
    masses: EventTerm | None = None
    """Masses of cart and pole, drawn for each environment; set by domain randomisation."""


@dataclass(kw_only=True)
class Cartpole(Task):
    """Base of both tasks. Success: at the episode's end the pole stands and is nearly at rest, and the cart is on
    its rail. Metrics: the pole's angle and the cart's distance from the middle.
    """  # fmt: skip

    state_type: ClassVar[type[TaskState]] = CartpoleMemory
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=150, hidden_sizes=(64, 64), entropy_weight=0.0),
        view=look_at(eye=(0.0, -4.2, 1.6), target=(0.0, 0.0, 1.1)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the rail is fixed; cart and pole start at joint positions"),
            TaskException(TaskCheck.START_YAW, "the rail is fixed; cart and pole start at joint positions"),
        ),
    )
    robot: str = "cartpole"
    action: str = "composed"
    actions: Any = field(default_factory=lambda: ActionTerms(cart=JointEffortConfig(joints=(SLIDER,), scale=STRONGEST)))
    episode_length: float = 10.0
    start_angle: float
    """rad from the vertical."""
    spread: tuple[float, float, float, float]
    """m, rad, m/s and rad/s around the start."""
    observations: CartpoleObservations = field(default_factory=CartpoleObservations)
    rewards: CartpoleRewards = field(default_factory=CartpoleRewards)
    terminations: SwingUpTerminations = field(default_factory=SwingUpTerminations)
    events: CartpoleEvents = field(default_factory=CartpoleEvents)

    def scene(self) -> Scene:
        return Scene(robots=(cartpole(self.robot),), terrain=(common.floor(),), physics_dt=self.physics_dt)

    def randomize(self) -> None:
        """The masses of cart and pole, and noise on what is seen of them."""
        self.events.masses = EventTerm(randomize.masses(common.ROBOT, Range(0.7, 1.5)), EventTime.STARTUP)
        common.add_noise(self.observations.policy, state=0.01)

    def success(self, env: Environment) -> Tensor:
        _, angle, _, rate = state(env).unbind(1)
        return (angle.abs() < 0.2) & (rate.abs() < 1.0) & ~left(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"angle_rad": state(env)[:, 1].abs(), "cart_m": state(env)[:, 0].abs()}

    def expert(self, env: Environment) -> SwingUpController:
        return SwingUpController(env)


@dataclass(kw_only=True)
class CartpoleBalance(Cartpole):
    """The pole begins near the vertical, and an episode ends when it leans by more than ``most_lean``."""

    start_angle: float = 0.0
    spread: tuple[float, float, float, float] = (0.2, 0.1, 0.2, 0.2)
    most_lean: float = math.radians(24.0)
    """rad; twice that of Barto, Sutton and Anderson (1983), whose motor was of 10 N."""
    terminations: SwingUpTerminations = field(default_factory=BalanceTerminations)


@dataclass(kw_only=True)
class CartpoleSwingUp(Cartpole):
    """The pole begins hanging."""

    start_angle: float = math.pi
    spread: tuple[float, float, float, float] = (0.2, 0.3, 0.1, 0.3)
    metadata: TaskMetadata = replace(
        Cartpole.metadata,
        ppo=PpoSettings(iterations=300, hidden_sizes=(64, 64), entropy_weight=0.002),
    )


class SwingUpController(Node):
    """Gives the pole the energy that it has at the top, and holds it there.

    Raises:
        ConfigurationError: the action is not the effort of the cart.
    """

    def __init__(self, env: Environment[Cartpole]) -> None:
        self.name = "policy"
        """Name of the node in the agent's graph, where it takes the policy's place."""
        generator = env.actions.generators[0]
        if not isinstance(generator, JointEffort) or generator.command_size != 1:
            raise ConfigurationError(f"the expert gives the cart's effort: action '{env.task.action}' does not take it")
        self._generator, self._env = generator, env
        self.outputs = (Port("action", (1,)),)
        """Port of the action, (1,): the cart's effort, scaled as the action space takes it."""
        links = {link.name: link for link in common.robot_of(env.world).spec.articulation.links}
        pole, self._gravity = links["pole"], -env.world.scene.gravity[2]
        arm = pole.center_of_mass[2]
        self._first_moment = pole.mass * arm
        # Of the pole about its hinge.
        self._inertia = float(pole.inertia[1, 1]) + pole.mass * arm**2
        self._mass = pole.mass + links["cart"].mass
        self._gains = self._regulator(env.step_dt).to(env.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        now = state(self._env)
        cart, angle, speed, rate = now.unbind(1)
        sine, cosine, gravity = angle.sin(), angle.cos(), self._gravity
        energy = 0.5 * self._inertia * rate.square() + self._first_moment * gravity * (cosine - 1.0)
        top = self._first_moment * gravity
        # What the pole gains is the cart's acceleration times what follows from its own motion.
        # Clamped, so that the first swings do not take the cart to the end of the rail.
        pumped = (25.0 * energy / top * rate * cosine).clamp(-6.0, 6.0) - 2.0 * cart - 1.5 * speed
        turn = (self._first_moment / self._inertia) * (gravity * sine - pumped * cosine)
        push = self._mass * pumped + self._first_moment * (turn * cosine - rate.square() * sine)
        # By the energy too: a pole that passes the top fast cannot be held there.
        caught = (angle.abs() < _CATCH) & (energy.abs() < 0.5 * top)
        effort = torch.where(caught, -(now * self._gains).sum(1), push)
        return {"action": self._generator.encode_efforts(effort[:, None])}

    def _regulator(self, dt: float) -> Tensor:
        """(4,) N per unit of the state, from the discrete Riccati equation of what moves near the top."""
        inertia = torch.tensor([[self._mass, self._first_moment], [self._first_moment, self._inertia]])
        inverse = torch.linalg.inv(inertia.double())
        a, b = torch.zeros(4, 4).double(), torch.zeros(4, 1).double()
        a[:2, 2:] = torch.eye(2)
        a[2:, 1], b[2:, 0] = inverse[:, 1] * self._first_moment * self._gravity, inverse[:, 0]
        step = torch.linalg.matrix_exp(torch.cat((torch.cat((a, b), 1), torch.zeros(1, 5)), 0) * dt)
        a, b = step[:4, :4], step[:4, 4:]
        weights = torch.diag(torch.tensor(_WEIGHTS[0])).double()
        cost, gains = weights, torch.zeros(1, 4).double()
        for _ in range(1000):
            gains = torch.linalg.solve(_WEIGHTS[1] + b.T @ cost @ b, b.T @ cost @ a)
            cost = weights + a.T @ cost @ (a - b @ gains)
        return gains[0].float()
