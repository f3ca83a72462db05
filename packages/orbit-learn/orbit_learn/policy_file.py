"""Policies as safetensors files: weights, description of the environment, and the network that they belong to.

The document of such a file (see :mod:`orbit_data.tensor_file`) is
``{"format": 1, "policy": {...}, "manifest": {...}, "network": {"name": ..., "settings": {...}}}`` with the fields of
:class:`~orbit_learn.description.PolicyDescription`, of :class:`~orbit_data.manifest.manifest.Manifest`, which may
be missing, and of a registered network.

A network is a frozen dataclass of plain settings that builds a module; the module's weights are next to the settings in
the file. Packages add networks through the entry-point group ``orbit.networks``, whose value is the dataclass::

    [project.entry-points."orbit.networks"]
    my_network = "my_package.networks:MyNetwork"
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from orbit_core.configuration import from_plain
from orbit_core.files import as_path
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_core.registry import ClassRegistry
from orbit_data.manifest.manifest import Manifest
from orbit_data.tensor_file import read_tensors, write_tensors
from orbit_learn.cloning.networks import ClonedDiffusion, ClonedPerceptron, ClonedRecurrent, ClonedTransformer
from orbit_learn.description import PolicyDescription
from orbit_learn.networks import ActorNetwork, Convolutional, Network, Perceptron
from orbit_learn.policy_cost import limited

GROUP = "orbit.networks"
"""Group of entry points of packages with networks."""


_OWN = (Perceptron, Convolutional, ClonedPerceptron, ClonedRecurrent, ClonedTransformer, ClonedDiffusion)


@cache
def _networks() -> ClassRegistry[Network]:
    return ClassRegistry[Network]("network", GROUP, _OWN)


def register_network(kind: type[Network]) -> None:
    """Register a network for this process; installed packages use an entry point instead.

    Raises:
        ConfigurationError: the class is not a dataclass with a class variable ``name``, or the name is taken.
    """
    _networks().add_class(kind)


def network_type(name: str) -> type[Network]:
    """Return a network by name.

    Raises:
        UnknownNameError: no network has the name; the message gives the nearest, and the packages that failed.
        ConfigurationError: two packages have a network with the name.
    """
    return _networks().get(name)


SUFFIX = ".safetensors"


def newest_file(folder: Path | str, prefix: str) -> Path | None:
    """Return the file ``<prefix>_<iteration>.safetensors`` of the highest iteration; None if there is none.

    Raises:
        ConfigurationError: the file is a link to a place outside of the folder.
    """
    folder = as_path(folder)
    pattern = re.compile(rf"{prefix}_(\d{{1,18}}){re.escape(SUFFIX)}")
    found = {int(match[1]): path for path in folder.iterdir() if (match := pattern.fullmatch(path.name))}
    if not found:
        return None
    newest = found[max(found)]
    # A link could lead to any file, which would then be loaded as this training's policy.
    if newest.resolve().parent != folder.resolve():
        raise ConfigurationError(f"{newest} is a link that leads out of its folder: name the file that it leads to")
    return newest


def write_policy(
    path: Path | str, actor: ActorNetwork, description: PolicyDescription, manifest: Manifest | None = None
) -> None:
    """Write a policy with the manifest of its environment; the file appears complete or not at all.

    Args:
        path: path of the file, which is replaced.
        actor: network and module.
        description: policy's description.
        manifest: manifest of the environment, if it is known.

    Raises:
        ConfigurationError: the file could not be read, because the network is not registered, or another has its name.
    """
    network = cast(Any, actor.network)
    if network_type(network.name) is not type(network):
        raise ConfigurationError(f"network {network!r} is not the one that is registered as '{network.name}'")
    named = {"name": network.name, "settings": dataclasses.asdict(network)}
    document = {**description.document(), **manifest_document(manifest), "network": named}
    write_tensors(path, document, actor.module.state_dict())


def manifest_document(manifest: Manifest | None) -> dict[str, Any]:
    """Return the manifest's part of a policy's document, which files of earlier versions do not have."""
    return {} if manifest is None else {"manifest": manifest.document()}


def manifest_of(document: Mapping[str, Any], path: Path) -> Manifest | None:
    """Return the manifest in a policy's document, if there is one.

    Raises:
        ConfigurationError: the manifest is invalid, or of another format.
    """
    return Manifest.decode(document["manifest"], str(path)) if "manifest" in document else None


def read_policy(path: Path | str) -> tuple[PolicyDescription, Manifest | None, ActorNetwork]:
    """Read a policy on the CPU; the only executed code is that of the registered network that the file names.

    Raises:
        OrbitError: the file is malformed, or its parts do not fit each other; the message names them.
    """
    path = as_path(path)
    document, tensors = read_tensors(path)
    description = PolicyDescription.of_document(document, str(path))
    network = _network(document.get("network"), str(path))
    try:
        with torch.device("meta"):  # so that settings of a huge network cost nothing before the weights agree
            module = network.build(description.observation_size, description.action_size)
    except (RuntimeError, ValueError, TypeError) as error:
        raise ConfigurationError(f"{path}: {network!r} cannot be built: {error}") from error
    _check_weights(module, tensors, path)
    # Assigned, not copied: on the meta device the module's own weights have no memory.
    module.load_state_dict(tensors, assign=True)
    module.requires_grad_(False).eval()
    check_action(module, description, path)
    return description, manifest_of(document, path), ActorNetwork(network, module)


def check_action(module: nn.Module, description: PolicyDescription, path: Path, device: str = "cpu") -> None:
    """Refuse a policy that computes no valid actions from an observation of zeros.

    Args:
        module: policy's module.
        description: policy's description.
        path: path of the file, for messages.
        device: device of the module; ``meta`` checks only shapes.

    Raises:
        ConfigurationError: the module fails or takes too much memory or time, or its actions have another shape or are
            not finite.
    """
    try:
        with torch.no_grad(), limited(module):
            action = module(description.zeros(2, device))
    except (RuntimeError, TypeError, IndexError, KeyError, ValueError) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise ConfigurationError(f"{path} cannot act: {type(error).__name__} {reason}") from error
    if tuple(action.shape) != (2, description.action_size):
        raise ConfigurationError(
            f"{path} makes actions of shape {tuple(action.shape)} of 2 observations, not (2, {description.action_size})"
        )
    if not action.is_meta and not bool(torch.isfinite(action).all()):
        raise ConfigurationError(f"{path} makes actions that are not finite of an observation of zeros")


def _network(values: Any, where: str) -> Network:
    if not isinstance(values, dict) or not isinstance(values.get("name"), str):
        raise ConfigurationError(f"{where} names no network")
    name = values["name"][:60]  # messages must not repeat a long text of an untrusted file
    try:
        kind = network_type(name)
    except OrbitError as error:
        raise ConfigurationError(f"{where}: {error}") from None
    return from_plain(kind, values.get("settings"), f"network '{name}' of {where}")


def _check_weights(module: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    # Before loading, whose own messages name all differences at once, in torch's terms.
    needed = module.state_dict()
    for name in sorted(needed.keys() ^ tensors.keys()):
        verb = "lacks" if name in needed else "has no place for"
        raise ConfigurationError(f"{path}: its network {verb} weights '{name[:60]}'")
    for name, asked in needed.items():
        given = tensors[name]
        if (asked.shape, asked.dtype) != (given.shape, given.dtype):
            raise ConfigurationError(
                f"{path} has '{name}' of shape {tuple(given.shape)} and {given.dtype}, where its network needs "
                f"{tuple(asked.shape)} and {asked.dtype}"
            )
