"""Scripted experts: a batched state machine that leads the hand from pose to pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_error, quat_from_rotation_vector, quat_multiply
from orbit_core.interfaces import Node, Port
from orbit_core.tasks.task import Task
from orbit_core.tasks.terms import TermFunction

if TYPE_CHECKING:
    from orbit_core.world import SimulatedWorld


@dataclass(frozen=True)
class Phase:
    """Lead the hand to ``target`` (N, 7), in each environment's frame, with the gripper open or closed.

    The phase is over once the hand is within both tolerances and ``dwell`` seconds have passed since it began; or, if
    ``timeout`` is given, after that many seconds. The last phase goes on for ever.
    """

    target: TermFunction
    gripper_open: bool = True
    position_tolerance: float = 0.01
    rotation_tolerance: float = 0.1
    dwell: float = 0.0
    timeout: float | None = None


class Expert(Node):
    """Runs each environment through its phases and turns the hand's next pose into an action of the task's own space.

    The pose asked for runs ahead of the hand by at most ``position_lead`` (m) and ``rotation_lead`` (rad), so that the
    same expert suits absolute and relative action spaces; how fast the hand follows is the drives' affair.
    """

    def __init__(
        self,
        world: SimulatedWorld,
        task: Task,
        phases: Sequence[Phase],
        position_lead: float = 0.1,
        rotation_lead: float = 0.5,
    ) -> None:
        self.name = "policy"
        self.outputs = (Port("action", (sum(generator.command_size for generator in task.generators),)),)
        self._world = world
        self._task = task
        self._phases = tuple(phases)
        self._dt = task.physics_dt * task.decimation
        self._robot = world.robots["robot"]
        self._frame = self._robot.spec.end_effector.frame
        self._lead = torch.tensor([position_lead, rotation_lead], device=world.device)
        tolerances = [(phase.position_tolerance, phase.rotation_tolerance) for phase in phases]
        self._tolerances = torch.tensor(tolerances, device=world.device)
        self._dwell = torch.tensor([phase.dwell for phase in phases], device=world.device)
        timeouts = [torch.inf if phase.timeout is None else phase.timeout for phase in phases]
        self._timeouts = torch.tensor(timeouts, device=world.device)
        self._open = torch.tensor([phase.gripper_open for phase in phases], device=world.device)
        self.phase = torch.zeros(world.num_envs, dtype=torch.int64, device=world.device)
        self._elapsed = torch.zeros(world.num_envs, device=world.device)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self.phase[rows] = 0
        self._elapsed[rows] = 0.0

    def memory(self) -> Mapping[str, Tensor]:
        return {"phase": self.phase, "elapsed": self._elapsed}

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.reset((self._task.episode_step == 0).nonzero().squeeze(-1))
        hand = self._robot.frame_pose(self._frame)
        target = self._target()
        error = pose_error(hand, target)
        distances = torch.stack((error[:, :3].norm(dim=1), error[:, 3:].norm(dim=1)), dim=1)
        step = error.view(-1, 2, 3) * (self._lead / distances.clamp_min(1e-9)).clamp(max=1.0)[..., None]
        turned = quat_multiply(quat_from_rotation_vector(step[:, 1]), hand[:, 3:])
        waypoint = torch.cat((hand[:, :3] + step[:, 0], turned), dim=1)
        opened = self._open[self.phase]
        commands = [generator.encode(waypoint, opened) for generator in self._task.generators]
        self._advance(distances)
        return {"action": torch.cat(commands, dim=1).clamp(-1.0, 1.0)}

    def _target(self) -> Tensor:
        targets = torch.stack([phase.target(self._world, self._task) for phase in self._phases])
        return targets[self.phase, torch.arange(self._world.num_envs, device=self._world.device)]

    def _advance(self, distances: Tensor) -> None:
        self._elapsed += self._dt
        arrived = (distances <= self._tolerances[self.phase]).all(1) & (self._elapsed >= self._dwell[self.phase])
        over = (arrived | (self._elapsed >= self._timeouts[self.phase])) & (self.phase < len(self._phases) - 1)
        self.phase += over
        self._elapsed.masked_fill_(over, 0.0)
