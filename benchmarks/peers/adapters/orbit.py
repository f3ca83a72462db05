"""ORBIT's environments, and raw stepping of their native models through the same motions."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import torch
from session import ACTIONS, Block, Facts, Request, Session, repeated

from orbit_conformance.throughput import PICTURE, raw_steppers, stagger
from orbit_core.backends import versions_of
from orbit_core.envs import Environment
from orbit_core.envs import make as make_environment
from orbit_core.rollout.pictures import OverviewCamera


class OrbitSession(Session):
    """Environments of ORBIT; options are ``backend``, and ``fields`` of the task."""

    def __init__(self, request: Request) -> None:
        torch.set_num_threads(1)  # as the command line does: the engine needs the cores
        self.num_envs = request.num_envs
        self._environment = make_environment(
            request.environment, request.num_envs, request.options["backend"], request.device, request.seed,
            compile=request.way == "compiled", **request.options.get("fields", {}),
        )  # fmt: skip
        shape = (ACTIONS, self.num_envs, self._environment.action_size)
        generator = torch.Generator().manual_seed(request.seed)
        actions = 2.0 * torch.rand(shape, generator=generator) - 1.0
        self._actions = cycle(actions.to(self._environment.device).unbind())
        stagger(self._environment, request.seed)
        self.facts = facts(self._environment, request.options["backend"])
        self._raw = raw_steppers(self._environment)
        self._recorder = next(iter(self._raw.values()), None)
        self._commands: list[Any] = []
        self._camera: OverviewCamera | None = None

    def step(self) -> None:
        self._environment.step(next(self._actions))
        if self._recorder is not None:
            self._commands.append(self._recorder.command())

    def settle(self) -> None:
        for _ in range(4):  # the second step is traced and compiled, and on a GPU the fourth recorded
            self.step()

    def stepped(self, seconds: float) -> Block:
        for stepper in self._raw.values():
            stepper.synchronize()
        self._commands.clear()
        return super().stepped(seconds)

    def stepped_raw(self, seconds: float) -> Block | None:
        # From the state in which the last block of steps began, by its commands: the same motions and contacts.
        blocks = {name: self._replay(stepper, seconds) for name, stepper in self._raw.items()}
        best = min(blocks, key=lambda name: blocks[name].seconds / blocks[name].count, default=None)
        # The fastest way of raw stepping is the yardstick from now on.
        self._raw = {name: stepper for name, stepper in self._raw.items() if name == best}
        return None if best is None else blocks[best]

    def _replay(self, stepper: Any, seconds: float) -> Block:
        commands = iter(self._commands)
        decimation = self._environment.task.decimation
        count, taken = 0, 0.0
        for command in commands:
            _, once = repeated(lambda command=command: stepper.step(command, decimation), 0.0)
            count, taken = count + self.num_envs, taken + once
            if taken >= seconds:
                break
        _, rest = repeated(self.wait, 0.0)
        return Block(count, taken + rest)

    def wait(self) -> None:
        if self._environment.device.type != "cpu":
            torch.accelerator.synchronize(self._environment.device)

    def draw(self) -> None:
        if self._camera is None:
            view = self._environment.task.metadata.view
            self._camera = OverviewCamera(self._environment.world, PICTURE, PICTURE, view)
        self._camera.pictures(torch.zeros(1, dtype=torch.int64, device=self._environment.device))

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
        self._environment.close()


def make(request: Request) -> OrbitSession:
    """Make the requested environments."""
    return OrbitSession(request)


def facts(environment: Environment, backend: str) -> Facts:
    """Return the environments' properties.

    Args:
        environment: environments to describe.
        backend: name of their backend.
    """
    task, scene = environment.task, environment.world.scene
    entities = (*scene.robots, *scene.objects)
    free = 6 * sum(not entity.fixed_base for entity in entities)
    known = {"orbit", "python", "torch"}
    engine = ", ".join(f"{name} {text}" for name, text in versions_of(backend).items() if name not in known)
    return Facts(
        engine=engine,
        physics_dt=task.physics_dt,
        decimation=task.decimation,
        action_size=environment.action_size,
        degrees_of_freedom=free + sum(len(entity.articulation.joints) for entity in entities),
    )
