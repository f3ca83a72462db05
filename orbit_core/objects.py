"""Kinds of objects by name, each with typed parameters. Packages add theirs through the group ``orbit.objects``.

A kind is a frozen dataclass derived from :class:`ObjectConfig` with a class variable ``name`` and a default for every
parameter; an entry point's value is that class::

    [project.entry-points."orbit.objects"]
    mug = "my_package.mug:MugConfig"

A task that has a field annotated ``ObjectConfig`` takes any kind there: ``--set cube=sphere --set cube.radius=0.03``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

from orbit_core.configuration import configured
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.registry import ClassRegistry
from orbit_core.scene import ObjectSpec, Pose

GROUP = "orbit.objects"


@dataclass(frozen=True, kw_only=True)
class ObjectConfig(ABC):
    """Parameters that an object of one kind is made from; each has a default."""

    name: ClassVar[str]
    """The kind's name in the catalogue."""

    @abstractmethod
    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        """Return the object.

        Args:
            name: of the object in its scene.
            pose: at reset, in the environment's frame; None takes the kind's own.

        Raises:
            AssetError: the parameters describe nothing that can be simulated.
        """

    @property
    @abstractmethod
    def rest_height(self) -> float:
        """Metres from what the object stands on, upright, to the origin of its frame."""


@cache
def object_kinds() -> ClassRegistry[ObjectConfig]:
    """Return all installed kinds of objects, read once; ``object_kinds().add_class(MugConfig)`` adds one."""
    return ClassRegistry[ObjectConfig]("object", GROUP, (), ObjectConfig)


def object_config(name: str, /, **parameters: Any) -> ObjectConfig:
    """Return the kind of that name with some of its parameters set, by path: ``object_config("box", mass=0.2)``.

    Raises:
        UnknownNameError: there is no such kind or parameter; names the nearest.
        ConfigurationError: a value is not of the kind that the parameter takes, or a third party's kind has a parameter
            without a default.
    """
    kind = object_kinds().get(name)
    try:
        defaults = kind()
    except TypeError as error:
        raise ConfigurationError(f"object '{name}' ({kind.__module__}) cannot be made by name: {error}") from error
    return configured(defaults, parameters, f"object '{name}'", "parameter")
