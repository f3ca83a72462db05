"""Finds physics engines, renderers and matter solvers: plugins under the entry-point groups ``orbit.backends``, for
what draws and simulates nothing ``orbit.renderers``, and for what simulates deformables ``orbit.matter``, by name.

Nothing is imported until a backend is asked for. The core knows no engine's name: those that could be installed are
the extras of the distribution ``orbit-core`` that bring a distribution ``orbit-<extra>``, but for ``matter``, which
brings a matter solver. An entry point that ends in ``[extra]`` needs that extra of its distribution.
"""

from __future__ import annotations

import functools
import os
import platform
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import importlib_metadata

from orbit_core import __version__
from orbit_core.configuration import configured, settings_table
from orbit_core.installing import install_extra, upgrade_command
from orbit_core.interfaces.backend import CONTRACT, Backend, contract_text
from orbit_core.interfaces.capabilities import IMAGES, MATTER, Capability
from orbit_core.interfaces.errors import (
    BackendNotInstalledError,
    ConfigurationError,
    OrbitError,
    UnknownNameError,
    UnsupportedCapabilityError,
)
from orbit_core.interfaces.matter import NATIVE, MatterSolver
from orbit_core.registry import Registry, faults_named

if TYPE_CHECKING:
    from orbit_core.scene import Scene

_Plugin = TypeVar("_Plugin", Backend, MatterSolver)
GROUP = "orbit.backends"
RENDERERS = "orbit.renderers"
MATTER_SOLVERS = "orbit.matter"
_MATTER_EXTRA = "matter"
# Extras that bring a distribution of the same name which simulates nothing
_NO_PLUGINS = frozenset({"conformance", "data", "deploy", "ros", "scenes", "sound", "tasks", "viewer"})


def backend_names() -> list[str]:
    """The installed backends, sorted; none of them is imported."""
    return sorted(_backends().names)


def default_backend() -> str:
    """The backend of those who name none: the environment variable ``ORBIT_BACKEND``, or the only one installed.

    Raises:
        ConfigurationError: none is installed, or several are.
    """
    if chosen := os.environ.get("ORBIT_BACKEND"):
        return chosen
    names = backend_names()
    if len(names) == 1:
        return names[0]
    if names:
        raise ConfigurationError(
            f"several backends are installed: say which, backend = {' or '.join(map(repr, names))}"
        )
    raise ConfigurationError(f"no backend is installed: {' or '.join(installable_backends().values())}")


def installable_backends() -> dict[str, str]:
    """Each backend that is known but not installed, with the command that installs it."""
    points = importlib_metadata.entry_points(group=GROUP)
    here = {point.dist.name for point in points if point.dist} | {f"orbit-{_MATTER_EXTRA}"}
    commands = {name: install_extra(name) for name in _extras() if f"orbit-{name}" not in here}
    commands |= {point.name: _command_with_extra(point) for point in points if not _is_complete(point)}
    installed = {*_backends().names}
    return {name: command for name, command in commands.items() if name not in installed}


def installable_matter() -> dict[str, str]:
    """The matter solver of ``orbit-core``'s own extra with the command that installs it, unless it is installed."""
    name = f"orbit-{_MATTER_EXTRA}"
    known = _MATTER_EXTRA in _extras() and name not in matter_names()
    return {name: install_extra(_MATTER_EXTRA)} if known else {}


def renderer_names() -> list[str]:
    """The installed plugins that draw and simulate nothing, sorted; backends may draw too."""
    return sorted(_renderers().names)


def backend(name: str) -> Backend:
    """The backend of that name, made once and kept.

    Raises:
        BackendNotInstalledError: it is known but not installed; says how to install it.
        UnknownNameError: no backend has that name.
        ConfigurationError: its plugin fails to import, or is no backend, or only draws, or two distributions bring it;
            names the plugin and the cause.
    """
    try:
        return _made(_backends(), name)
    except UnknownNameError:
        installable = installable_backends()
        if not isinstance(name, str):
            raise UnknownNameError("backend", name, {*backend_names(), *installable}) from None
        if name in installable:
            raise BackendNotInstalledError(f"backend '{name}' is not installed: {installable[name]}") from None
        if name in renderer_names():
            raise ConfigurationError(
                f"'{name}' draws and simulates nothing: give it as renderer, and another backend"
            ) from None
        raise UnknownNameError("backend", name, {*backend_names(), *installable}) from None


def renderer(name: str) -> Backend:
    """Return the renderer of that name, made once and kept, or the backend that draws under it.

    Raises:
        BackendNotInstalledError, UnknownNameError, ConfigurationError: as :func:`backend`.
    """
    if isinstance(name, str) and name in renderer_names():
        return _made(_renderers(), name)
    try:
        return backend(name)
    except UnknownNameError:
        known = {*backend_names(), *installable_backends(), *renderer_names()}
        raise UnknownNameError("renderer", name, known) from None


def matter_names() -> list[str]:
    """The installed matter solvers, sorted; none of them is imported."""
    return sorted(_matter_solvers().names)


def matter_solver(name: str) -> MatterSolver:
    """The matter solver of that name, made once and kept.

    Raises:
        UnknownNameError: no installed solver has that name.
        ConfigurationError: its plugin fails to import, or is no matter solver.
    """
    if name not in matter_names():
        note = installable_matter().get(name, "") if isinstance(name, str) else ""
        raise UnknownNameError(
            "matter solver", name, {NATIVE, *matter_names()}, note=note and f"it is not installed: {note}"
        )
    return _kept_matter(name)


def choose_matter(backend: Backend, scene: Scene, name: str | None) -> MatterSolver | None:
    """Choose the solver of a scene's deformables; None if the engine itself has them or there are none.

    Args:
        backend: what simulates the rest.
        scene: what is asked for.
        name: of the solver, or ``"native"``. None takes the first installed solver that does all that the scene needs,
            so that a scene means the same thing on every engine, and else the engine's own.

    Raises:
        UnknownNameError: no installed solver has that name.
        UnsupportedCapabilityError: the solver that is named lacks what the scene needs; says what has it.
    """
    # Names and declarations of plugins are read without scenes, which take longer to load.
    from orbit_core.interfaces.requirements import required_capabilities

    needs = {need: culprit for need, culprit in required_capabilities(scene).items() if need in MATTER}
    named = None if name is None or name == NATIVE else matter_solver(name)
    if not needs or name == NATIVE:
        return None
    if named is not None:
        _check_matter(named, needs)
        return named
    solvers = [matter_solver(each) for each in matter_names()]
    return next((solver for solver in solvers if _simulates(solver, needs)), None)


def _check_matter(solver: MatterSolver, needs: Mapping[Capability, str]) -> None:
    capabilities = solver.capabilities()
    for need, culprit in needs.items():
        if not capabilities.has(need):
            able = _able(backend_names(), (need,)) + [
                each for each in matter_names() if matter_solver(each).capabilities().has(need)
            ]
            remedy = f"{' or '.join(map(repr, able))} does" if able else "nothing that is installed does"
            raise UnsupportedCapabilityError(
                f"matter solver '{solver.name}' does not do {need.value} (needed by {culprit}; "
                f"{capabilities[need].reason}): {remedy}"
            )


def check_scene(
    backend: Backend, scene: Scene, renderer: Backend | None = None, matter: MatterSolver | None = None
) -> None:
    """Refuse a scene that needs what the backend, or the renderer of its images, lacks, before anything is built.

    Args:
        backend: what simulates.
        scene: what is asked for.
        renderer: what draws; the backend if None.
        matter: what simulates deformables; the backend if None.

    Raises:
        UnsupportedCapabilityError: names each capability, what needs it, why it is missing and what has it.
    """
    from orbit_core.interfaces.requirements import required_capabilities

    needs = required_capabilities(scene)
    others = IMAGES if matter is None else (*IMAGES, *MATTER)
    physics = {need: culprit for need, culprit in needs.items() if need not in others}
    if matter is not None:  # whose wrenches the engine is to take
        _check_matter(matter, {need: culprit for need, culprit in needs.items() if need in MATTER})
    drawn = (*IMAGES, Capability.SHAPES_PER_ENVIRONMENT)  # who draws must know of other shapes too
    images = {need: culprit for need, culprit in needs.items() if need in drawn}
    _check("backend", backend, physics, backend_names())
    _check("renderer", renderer or backend, images, (*backend_names(), *renderer_names()))


def check_capability(plugin: Backend, capability: Capability, culprit: str) -> None:
    """Refuse a call that needs what a backend, or the renderer of images, lacks.

    Raises:
        UnsupportedCapabilityError: names the capability, what needs it, why it is missing and what has it.
    """
    if not plugin.capabilities().has(capability):
        kind, others = (
            ("renderer", (*backend_names(), *renderer_names()))
            if capability in IMAGES
            else ("backend", backend_names())
        )
        _check(kind, plugin, {capability: culprit}, others)


def _check(kind: str, plugin: Backend, needs: Mapping[Capability, str], others: Iterable[str]) -> None:
    capabilities = plugin.capabilities()
    missing = {need: culprit for need, culprit in needs.items() if not capabilities.has(need)}
    if not missing:
        return
    complaints = [
        f"{need.value} (needed by {culprit}; {capabilities[need].reason})" for need, culprit in missing.items()
    ]
    able = _able(others, missing)
    remedy = f"choose {kind} {' or '.join(repr(name) for name in able)}" if able else f"no installed {kind} does"
    if solvers := [name for name in matter_names() if _simulates(matter_solver(name), missing)]:
        remedy += f", and with matter={' or '.join(map(repr, solvers))} any backend does"
    elif not matter_names() and set(missing) <= {*MATTER}:
        remedy += f", and with a matter solver any may: {install_extra(_MATTER_EXTRA)}"
    raise UnsupportedCapabilityError(f"{kind} '{plugin.name}' does not do {', nor '.join(complaints)}: {remedy}")


def matter_config(solver: MatterSolver, values: Mapping[str, Any] | None = None) -> Any:
    """The typed settings of a matter solver, as :func:`backend_config` makes a backend's."""
    owner = f"matter solver '{solver.name}'"
    return configured(solver.config_type(), settings_table(values, owner), owner, "setting")


def _simulates(solver: MatterSolver, needs: Iterable[Capability]) -> bool:
    return all(solver.capabilities().has(need) for need in needs)


def backend_config(backend: Backend, values: Mapping[str, Any] | None = None) -> Any:
    """The typed settings of a backend or renderer, defaults where ``values`` has none; lists become tuples.

    Raises:
        ConfigurationError: a field that the backend does not have, or a value that it refuses.
    """
    owner = f"backend '{backend.name}'"
    return configured(backend.config_type(), settings_table(values, owner), owner, "setting")


@functools.cache
def _backends() -> Registry[Callable[[], Backend]]:
    return Registry("backend", GROUP, usable=_is_complete)


@functools.cache
def _renderers() -> Registry[Callable[[], Backend]]:
    return Registry("renderer", RENDERERS, usable=_is_complete)


@functools.cache
def _matter_solvers() -> Registry[Callable[[], MatterSolver]]:
    return Registry("matter solver", MATTER_SOLVERS, usable=_is_complete)


@functools.cache
def _kept_matter(name: str) -> MatterSolver:
    return _loaded(_matter_solvers(), name, MatterSolver)


def _made(registry: Registry[Callable[[], Backend]], name: str) -> Backend:
    registry.get(name)  # refuses what is no name at all
    return _kept(registry, name)


@functools.cache
def _kept(registry: Registry[Callable[[], Backend]], name: str) -> Backend:
    return _loaded(registry, name, Backend)


def _loaded(registry: Registry[Callable[[], Any]], name: str, kind: type[_Plugin]) -> _Plugin:
    """Load and create a plugin, after checking the version of the contract that it was written for.

    Raises:
        ConfigurationError: It cannot be loaded, was written for another version, or is not of that kind.
    """
    factory, distribution = registry.get(name), registry.distribution(name)
    plugin = f"{registry.kind} '{name}', {registry.origin(name)}"
    if isinstance(factory, type) and issubclass(factory, kind):
        # Before it is created: a class of another contract may lack methods that this one requires.
        _check_contract(plugin, distribution, factory)
    with faults_named(plugin, distribution):
        made = factory()
    if not isinstance(made, kind):
        raise ConfigurationError(
            f"{plugin}, makes a {type(made).__name__}, not an orbit_core.interfaces.{kind.__name__}"
        )
    _check_contract(plugin, distribution, type(made))
    return made


def _check_contract(plugin: str, distribution: str, kind: type[Backend | MatterSolver]) -> None:
    stated = getattr(kind, "contract", None)
    own = contract_text(CONTRACT)
    upgrade = f"{upgrade_command(distribution)}" if distribution else "install another version of it"
    if stated is None:
        raise ConfigurationError(
            f"{plugin}, does not state the version of the contract that it was written for, and orbit-core "
            f"{__version__} has {own}: {upgrade}, or, if it is your own, say contract = {CONTRACT} in {kind.__name__} "
            "(docs/write-a-backend.md)"
        )
    if not (isinstance(stated, tuple) and len(stated) == 2 and all(type(number) is int for number in stated)):
        raise ConfigurationError(
            f"{plugin}, states contract = {stated!r}, which is no pair of whole numbers such as {CONTRACT}"
        )
    major, minor = stated
    if major != CONTRACT[0] or minor > CONTRACT[1]:
        remedy = upgrade_command("orbit-core") if stated > CONTRACT else upgrade
        raise ConfigurationError(
            f"{plugin}, was written for version {contract_text(stated)} of the contract, and orbit-core {__version__} "
            f"has {own}: {remedy}"
        )


def versions_of(*backends: str | None, matter: str = "") -> dict[str, str]:
    """Versions of ORBIT, Python, torch, and what backends, renderers and a matter solver depend on, by their names."""
    import torch

    versions = {"orbit": __version__, "python": platform.python_version(), "torch": str(torch.__version__)}
    for name in backends:
        if name is not None:
            versions.update(renderer(name).versions())  # which finds backends too
    return versions | (matter_solver(matter).versions() if matter else {})


def _is_complete(entry_point: importlib_metadata.EntryPoint) -> bool:
    """Return True if the requirements of the entry point's extras are installed."""
    requirements = (entry_point.dist.requires if entry_point.dist else None) or []
    for extra in entry_point.extras:
        pattern = re.compile(rf"([\w.-]+).*extra\s*==\s*['\"]{re.escape(extra)}['\"]")
        needed = [match[1] for match in map(pattern.match, requirements) if match]
        if not needed or not all(map(_is_installed, needed)):
            return False
    return True


def _is_installed(distribution: str) -> bool:
    try:
        importlib_metadata.version(distribution)
    except importlib_metadata.PackageNotFoundError:
        return False
    return True


@functools.cache
def _extras() -> tuple[str, ...]:
    """Return the extras of this distribution that bring a plugin of the same name."""
    pattern = re.compile(r"orbit-([\w-]+)\b.*extra\s*==\s*['\"]\1['\"]")
    found = (match[1] for match in map(pattern.match, _requirements()) if match)
    return tuple(extra for extra in found if extra not in _NO_PLUGINS)


def _command_with_extra(entry_point: importlib_metadata.EntryPoint) -> str:
    """Return what installs an entry point's extra: this distribution's extra that brings it, or else its own."""
    own = f"{entry_point.dist.name if entry_point.dist else entry_point.name}[{entry_point.extras[0]}]"
    pattern = re.compile(rf"{re.escape(own)}.*extra\s*==\s*['\"]([\w-]+)['\"]")
    extra = next((match[1] for match in map(pattern.match, _requirements()) if match), None)
    return f'pip install "{own}"' if extra is None else install_extra(extra)


def _requirements() -> list[str]:
    """Return the requirements of this distribution, with and without extras."""
    try:
        return importlib_metadata.requires("orbit-core") or []
    except importlib_metadata.PackageNotFoundError:  # run from a source tree
        return []


def _able(names: Iterable[str], needs: Iterable[Capability]) -> list[str]:
    """Return the backends and renderers that have all of ``needs``; one that fails to load has nothing."""
    able: list[str] = []
    for name in names:
        try:
            capabilities = renderer(name).capabilities()  # which finds backends too
        except OrbitError:
            continue
        if all(capabilities.has(need) for need in needs):
            able.append(name)
    return able
