"""Steps, how long they are, what they hold, and what goes wrong in them."""

from __future__ import annotations

import contextlib
from typing import Any

import torch
from orbit_torch.engine import TorchEngine

from orbit_core.interfaces import SimulationError

from .mutant import mutant

EFFORT = "drives::test_effort_alone_accelerates"


@mutant(EFFORT)
class OneStepWhateverIsAsked(TorchEngine):
    """Takes one step where several are asked for."""

    def step(self, steps: int) -> None:
        super().step(1)


@mutant(EFFORT, "reset::test_steps_may_be_taken_together_or_apart")
class OneStepTooMany(TorchEngine):
    """Takes a step more than it is asked for."""

    def step(self, steps: int) -> None:
        super().step(steps + 1)


class _Paced(TorchEngine):
    """Of another time step than the scene's."""

    pace = 1.0

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._dt *= self.pace


@mutant(EFFORT)
class HalfSteps(_Paced):
    """Steps half as far in time as the scene says."""

    pace = 0.5


@mutant(EFFORT)
class CommandsOfOneStep(TorchEngine):
    """Holds efforts for the first step of several."""

    def step(self, steps: int) -> None:
        held = self.efforts.clone()
        super().step(1)
        self.efforts.zero_()
        if steps > 1:
            super().step(steps - 1)
        self.efforts.copy_(held)


@mutant("wrenches::test_an_external_force_accelerates")
class WrenchesOfOneCall(TorchEngine):
    """Drops external wrenches after each call of step."""

    def step(self, steps: int) -> None:
        super().step(steps)
        self._wrenches.zero_()


@mutant("reset::test_steps_may_be_taken_together_or_apart")
class WarmStartsOfOneCall(TorchEngine):
    """Forgets its impulses after each call of step."""

    def step(self, steps: int) -> None:
        super().step(steps)
        self._touching.zero_()


@mutant("reset::test_divergence_names_the_environments")
class DivergenceUnnoticed(TorchEngine):
    """Goes on with what is not a number."""

    def step(self, steps: int) -> None:
        with contextlib.suppress(SimulationError):
            super().step(steps)


@mutant("reset::test_divergence_names_the_environments")
class DivergenceOfAll(TorchEngine):
    """Names every environment when one diverges."""

    def step(self, steps: int) -> None:
        try:
            super().step(steps)
        except SimulationError:
            raise SimulationError(f"environments {', '.join(map(str, range(self.num_envs)))} diverged") from None


@mutant("reset::test_divergence_names_the_environments")
class DivergenceForEver(TorchEngine):
    """Is not well again after a reset."""

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        kept = self._rates.clone()
        super().reset(env_ids)
        self._rates.copy_(kept)


@mutant("state::test_shapes_and_dtypes")
class DoublePrecisionTold(TorchEngine):
    """Tells positions in double precision."""

    @property
    def joint_positions(self) -> torch.Tensor:
        return self._positions


@mutant("wrenches::test_an_external_force_accelerates", "free_fall")
class GravityOfTheEarth(TorchEngine):
    """Lets everything fall whatever the scene's gravity."""

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        super().reset(env_ids)
        self._gravity[:] = torch.tensor([0.0, 0.0, -9.80665])
