"""What every learning library must do for ``orbit train``."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.learning.networks import ActorNetwork

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


@dataclass(frozen=True)
class Progress:
    """How far a training has come."""

    iteration: int
    """The one just done, from 0."""
    env_steps: int
    """Of all environments together; a trainer counts since it was made, a training since its first iteration."""
    seconds: float
    """Of collecting and learning, counted likewise."""
    episode_return: float
    """Mean over the last episodes; NaN before any has ended."""
    success_rate: float
    """Of the last episodes; NaN before any has ended."""


class Trainer(ABC):
    """Trains one policy in one environment with one library.

    Args:
        environment: stepped by this trainer alone.
        settings: of the algorithm.
        folder: takes TensorBoard's files.
        seed: of exploration and of the networks' weights.
    """

    name: ClassVar[str]
    """As the user types it."""
    several_gpus: ClassVar[bool] = False
    """Whether processes that torchrun starts, one a GPU, learn one policy together."""

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path, seed: int) -> None:
        self.environment = environment
        self.settings = settings
        self.folder = folder
        self.seed = seed

    @abstractmethod
    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        """Collect and learn; tells after each iteration, and :meth:`state` and :meth:`actor` are then of its end."""

    @abstractmethod
    def state(self) -> Any:
        """All that learning goes on with, as :mod:`~orbit_core.learning.checkpoint` writes it."""

    @abstractmethod
    def restore(self, state: Any, iteration: int) -> None:
        """Go on from the state at the end of an iteration."""

    @abstractmethod
    def actor(self) -> ActorNetwork:
        """A copy of the policy on the CPU, without exploration, normalisation included."""


_LIBRARIES = {
    "rsl-rl": "orbit_core.learning.rsl_rl:RslRlTrainer",
    "sb3": "orbit_core.learning.sb3:Sb3Trainer",
    "skrl": "orbit_core.learning.skrl:SkrlTrainer",
    "rl-games": "orbit_core.learning.rl_games:RlGamesTrainer",
    "torchrl": "orbit_core.learning.torchrl:TorchRlTrainer",
}
"""Each is also the name of the extra that installs it."""


def library_names() -> tuple[str, ...]:
    """All libraries that train."""
    return tuple(_LIBRARIES)


def trainer_type(library: str) -> type[Trainer]:
    """The trainer of that library.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: the library is not installed.
    """
    if library not in _LIBRARIES:
        raise UnknownNameError("learning library", library, _LIBRARIES)
    module, _, attribute = _LIBRARIES[library].partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"library '{library}' needs {error.name}, which is not installed: pip install 'orbit-core[{library}]'"
        ) from error
