"""Learning libraries by name. Packages add theirs by the entry-point group ``orbit.learners``.

The value of an entry point is a subclass of :class:`~orbit_learn.trainer.Trainer`::

    [project.entry-points."orbit.learners"]
    my-library = "my_package.training:MyTrainer"

Listing names imports none of them.
"""

from __future__ import annotations

import importlib
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.registry import Registry

if TYPE_CHECKING:
    from orbit_learn.trainer import Trainer

GROUP = "orbit.learners"
# Modules in this package. Each but the last three is also the name of the extra that installs it.
_LIBRARIES = {
    "rsl-rl": ("rsl_rl:RslRlTrainer", "PPO, asymmetric critics, pictures, several processes and GPUs"),
    "sb3": ("sb3:Sb3Trainer", "PPO, pictures; SAC and TD3 on the host"),
    "skrl": ("skrl:SkrlTrainer", "PPO, asymmetric critics, pictures"),
    "rl-games": ("rl_games:RlGamesTrainer", "PPO, asymmetric critics"),
    "torchrl": ("torchrl:TorchRlTrainer", "PPO, asymmetric critics, pictures"),
    "orbit": (
        "off_policy:OffPolicyTrainer",
        "SAC and TD3 with large batches, PPO recorded on a GPU and of several, asymmetric critics; part of ORBIT",
    ),
    "distill": ("distill:DistillTrainer", "imitates a kept policy that sees more (DAgger); part of ORBIT"),
    "imitation": (
        "cloning.trainer:ImitationTrainer",
        "clones demonstrations (BC, BC-RNN, mixtures, ACT, diffusion); part of ORBIT",
    ),
}

# Trainers of algorithms that have a class of their own in a library of several.
_TRAINERS = {
    ("orbit", "ppo"): "ppo:PpoTrainer",
    ("sb3", "sac"): "sb3_off_policy:Sb3OffPolicyTrainer",
    ("sb3", "td3"): "sb3_off_policy:Sb3OffPolicyTrainer",
}
# Library that is used where an algorithm is named and no library.
_ALGORITHMS = {
    "ppo": "rsl-rl", "sac": "orbit", "td3": "orbit",
    **dict.fromkeys(("bc", "bc-gmm", "bc-rnn", "bc-rnn-gmm", "act", "diffusion"), "imitation"),
}  # fmt: skip


def library_for(algorithm: str | None) -> str:
    """Return the library that has an algorithm; that of PPO if none is named.

    Raises:
        UnknownNameError: no library of ORBIT has the algorithm; the message gives the nearest name.
    """
    algorithm = algorithm or "ppo"
    if algorithm not in _ALGORITHMS:
        raise UnknownNameError("algorithm", algorithm, _ALGORITHMS)
    return _ALGORITHMS[algorithm]


@cache
def learners() -> Registry[type[Trainer[Any]]]:
    """Return all trainers by name; each is imported when it is first requested."""
    registry = Registry["type[Trainer[Any]]"]("learning library", GROUP)
    for name, (place, _) in _LIBRARIES.items():
        registry.add_lazily(name, partial(_own_trainer, name, place))
    return registry


def library_names() -> tuple[str, ...]:
    """Return the names of all libraries."""
    return tuple(learners().names)


def library_description(name: str) -> str:
    """Return one line: the library's features, or the package that it comes from."""
    return _LIBRARIES[name][1] if name in _LIBRARIES else learners().origin(name)


def trainer_type(library: str, algorithm: str | None = None) -> type[Trainer[Any]]:
    """Return a library's trainer.

    Args:
        library: name of the library.
        algorithm: name of the algorithm, for a library that has a trainer for each; the library's own if None.

    Raises:
        UnknownNameError: the library is unknown; the message gives the nearest name.
        ConfigurationError: the library is not installed, or its package is broken.
    """
    from orbit_learn.trainer import Trainer

    place = _TRAINERS.get((library, algorithm or ""))
    kind = _own_trainer(library, place) if place else learners().get(library)  # the import happens here
    if not (isinstance(kind, type) and issubclass(kind, Trainer)):
        raise ConfigurationError(f"learning library '{library}' ({learners().origin(library)}) is no Trainer: {kind!r}")
    return kind


def _own_trainer(library: str, place: str) -> type[Trainer[Any]]:
    module, _, attribute = place.partition(":")
    try:
        return getattr(importlib.import_module(f"orbit_learn.{module}"), attribute)
    # Only missing modules: other errors within an installed library must stay visible.
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"library '{library}' needs {error.name}, which is not installed: {install_extra(library)}"
        ) from error
