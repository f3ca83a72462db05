"""A motor model of one's own: a motor of limited speed that moves its joint through a spring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from orbit_assets.catalogue import robot
from orbit_core.actuators import ActuatorContext, ActuatorModel, actuator_models
from orbit_core.scene import ActuatorConfig, Scene
from orbit_core.world import simulate


@dataclass(frozen=True, kw_only=True)
class SpringMotor(ActuatorConfig):
    """A motor that turns at most ``motor_speed`` (rad/s or m/s), and a spring and a damper between it and the joint."""

    motor_speed: float


class SpringMotorModel(ActuatorModel):
    """Effort of the spring between motor and joint, within the effort limit."""

    def __init__(self, context: ActuatorContext) -> None:
        super().__init__(context)
        self.gains = self._gains = context.values("stiffness"), context.values("damping")
        self._limit = context.effort_limits
        self._step = context.values("motor_speed") * context.physics_dt
        self.memory["motor"] = torch.full_like(self._step, torch.nan)  # NaN: not known before the first step

    def fresh(self, name: str) -> float:
        return torch.nan

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        stiffness, damping = self._gains
        motor = torch.where(self.memory["motor"].isnan(), position, self.memory["motor"])
        motor = motor + torch.clamp(targets[0] - motor, -self._step, self._step)
        self.memory["motor"].copy_(motor)  # in place: it lasts
        effort = stiffness * (motor - position) - damping * velocity + targets[2]
        return torch.clamp(effort, -self._limit, self._limit)


actuator_models().add("SpringMotor", SpringMotorModel)


def main() -> None:
    """Send a cart half a metre away with a motor of 0.2 m/s; it arrives after 2.5 s."""
    cartpole = robot("cartpole", name="robot")
    cart = SpringMotor(joints=cartpole.articulation.joint_names[:1], stiffness=500.0, damping=50.0, motor_speed=0.2)
    scene = Scene(robots=(replace(cartpole, actuators=(cart,)),), gravity=(0.0, 0.0, 0.0))
    world = simulate(scene, num_envs=1, backend="mujoco")
    world.robots["robot"].set_position_targets(torch.tensor([[0.5]]), [0])
    for _ in range(4):
        world.step(round(1.0 / scene.physics_dt))
        print(f"{float(world.robots['robot'].joint_positions[0, 0]):.3f} m")
    world.close()


if __name__ == "__main__":
    main()
