"""Networks that a policy's file may name. Packages add theirs through the entry-point group ``orbit.networks``.

A network is a frozen dataclass of plain settings that builds a module; the module's weights stand beside the settings
in the file. An entry point's value is the dataclass::

    [project.entry-points."orbit.networks"]
    my_network = "my_package.networks:MyNetwork"
"""

from __future__ import annotations

from functools import cache

from orbit_core.registry import ClassRegistry
from orbit_learn.cloning.networks import ClonedDiffusion, ClonedPerceptron, ClonedRecurrent, ClonedTransformer
from orbit_learn.convolutional import Convolutional
from orbit_learn.networks import Network, Perceptron

GROUP = "orbit.networks"
"""Entry points of packages that bring networks."""


_OWN = (Perceptron, Convolutional, ClonedPerceptron, ClonedRecurrent, ClonedTransformer, ClonedDiffusion)


@cache
def _networks() -> ClassRegistry[Network]:
    return ClassRegistry[Network]("network", GROUP, _OWN)


def register_network(kind: type[Network]) -> None:
    """Let files of this process name a network; installed packages use an entry point instead.

    Raises:
        ConfigurationError: it is no dataclass with a class variable ``name``, or the name is taken.
    """
    _networks().add_class(kind)


def network_type(name: str) -> type[Network]:
    """The network of that name.

    Raises:
        UnknownNameError: there is none; names the nearest, and the packages that were left out.
        ConfigurationError: two packages bring it.
    """
    return _networks().get(name)
