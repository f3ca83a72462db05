"""Fluid-Pouring: take a cup of liquid by its handle and pour it into a container."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import Meaning, measured_in, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Scene, look_at
from orbit_core.scene.pose import Vector3
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import fluid
from orbit_tasks.mdp.fluid import in_cup

TARGET = "target"
ROOM: Vector3 = (0.16, 0.16, 0.08)
"""Metres within the container."""
PLACE = (0.52, 0.2)
"""Metres in x and y of the container."""
OVER = 0.1
"""Metres of the cup's middle above the container's rim: the hand, which turns with it, is clear of the rim."""
SHORT = 0.05
"""Metres by which the cup stays behind the container's middle: liquid leaves it at its lip, and flies on."""
TILTS = (0.3, 0.6, 0.9, 1.05, 1.2, 1.35, 1.5, 1.65, 1.8, 1.95)
"""Rad of the cup, one after another: fast to where the first drops leave it, and slowly from there on."""

poured = fluid.amount_in(TARGET, ROOM)
"""(N,) in [0, 1], the part of the liquid that is in the container."""
spilt = fluid.spilt((in_cup, poured))
"""(N,) in [0, 1], the part of the liquid that is neither in the cup nor in the container."""


@measured_in("m")
@once_per_state
def target(env: Environment[FluidPouring]) -> Tensor:
    """(N, 3) the middle of the container's floor, in the environment's frame."""
    return env.world.objects[TARGET].root_pose[:, :3]


@once_per_state
def pouring_place(env: Environment[FluidPouring]) -> Tensor:
    """(N, 3) where the cup's middle is to be as it pours, in the environment's frame."""
    return target(env) + torch.tensor([0.0, -SHORT, ROOM[2] + OVER], device=env.device)


def distance(env: Environment[FluidPouring]) -> Tensor:
    """(N,) metres between the cup's middle and where it is to pour."""
    return vector_norm(pouring_place(env) - fluid.middle(env), dim=1)


def lifted(env: Environment[FluidPouring]) -> Tensor:
    """(N, 7) the hand with the cup as high as it is to pour."""

    def place(env: Environment[FluidPouring]) -> Tensor:
        return torch.cat((fluid.middle(env)[:, :2], pouring_place(env)[:, 2:]), dim=1)

    return fluid.carrying(place)(env)


@dataclass
class FluidPouringState(fluid.CupState):
    """The arm's joints and hand, cup and container, how much is in each, and the last action."""

    target: ObservationTerm | None = ObservationTerm(target)
    poured: ObservationTerm | None = ObservationTerm(
        poured, unit="1", meaning=Meaning("part of the liquid that is in the container, from 0 to 1")
    )


@dataclass
class FluidPouringObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: FluidPouringState = field(default_factory=FluidPouringState)
    critic: ObservationGroup | None = None


@dataclass
class FluidPouringRewards(fluid.CupRewards):
    """Rewards of the hand at the handle, the cup over the container and what is in it, less what is spilt or abrupt."""

    bring: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.2), 4.0)
    """Nearness of the cup's middle to the place from which it pours, within some 0.2 m."""
    pour: RewardTerm | None = RewardTerm(poured, 16.0)
    spill: RewardTerm | None = RewardTerm(spilt, -8.0)


@dataclass
class FluidPouringEvents(fluid.CupEvents):
    """Robot, cup and container are placed for each episode."""

    place_target: EventTerm | None = EventTerm(
        common.place_object(TARGET, (PLACE[0] - 0.03, PLACE[0] + 0.03), (PLACE[1] - 0.03, PLACE[1] + 0.03), 0.01)
    )


@dataclass(kw_only=True)
class FluidPouring(fluid.CupTask):
    """A filled cup stands in reach, and a container to the robot's left, each anywhere on a patch of the table.

    Succeeds when ``least_poured`` of the liquid is in the container at the episode's end. Metrics: that part, and the
    part that is neither there nor in the cup.
    """

    metadata: TaskMetadata = replace(
        fluid.CupTask.metadata, view=look_at(eye=(1.25, 0.55, 0.75), target=(0.5, 0.05, 0.15))
    )
    episode_length: float = 12.0
    least_poured: float = 0.9
    observations: FluidPouringObservations = field(default_factory=FluidPouringObservations)
    rewards: FluidPouringRewards = field(default_factory=FluidPouringRewards)
    events: FluidPouringEvents = field(default_factory=FluidPouringEvents)

    def scene(self) -> Scene:
        return self.with_cup(fluid.container(TARGET, ROOM, PLACE))

    def success(self, env: Environment) -> Tensor:
        return poured(env) >= self.least_poured

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"poured": poured(env), "spilt": spilt(env)}

    def expert(self, env: Environment) -> Expert:
        def tilted(tilt: float) -> Phase:
            # Loose and short: a cup that pours need not be still before it is tilted further.
            pose = fluid.carrying(pouring_place, tilt)
            return Phase(
                pose, gripper_open=False, position_tolerance=0.03, rotation_tolerance=0.1, dwell=0.4, timeout=1.0
            )

        return Expert(
            env,
            (
                *fluid.taking(env.world),
                Phase(lifted, gripper_open=False, position_tolerance=0.03, timeout=1.5),
                Phase(fluid.carrying(pouring_place), gripper_open=False, position_tolerance=0.02, timeout=3.5),
                *(tilted(tilt) for tilt in TILTS),
                # The last tilt once more, until the episode ends, for what still drips.
                Phase(fluid.carrying(pouring_place, TILTS[-1]), gripper_open=False),
            ),
        )
