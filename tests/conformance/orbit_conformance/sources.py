"""Digests of the code that a record comes from, so that a resumed run repeats the jobs of other code.

Versions do not suffice: a plugin that is being written changes from run to run under one version.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import importlib_metadata

from orbit_assets.catalogue import robot_info
from orbit_assets.sources import installed_version
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.settings import Settings
from orbit_conformance.transfer import learned
from orbit_core.backends import GROUP, MATTER_SOLVERS, RENDERERS, matter_names, matter_solver, renderer_names
from orbit_core.backends import backend as find_backend
from orbit_core.backends import renderer as find_renderer
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces import Backend
from orbit_core.interfaces.matter import NATIVE, MatterSolver
from orbit_learn.pretrained import pretrained_policy

CORE = "orbit_core"
# Packages whose code any job may run.
_SHARED = ("orbit_core", "orbit_assets", "orbit_motion", "orbit_learn", "orbit_conformance")
_SCENARIOS = "orbit_conformance.scenarios"
_SCENARIOS_WORDS = "the scenarios"
# Files of these packages that no job runs, and the scenarios, which have a digest of their own.
_IN_NO_JOB = ("cli/", "contract/", "report/", "scenarios/")


def source_digests(settings: Settings) -> dict[str, str]:
    """The digest of each body of code that a run depends on, by the words that messages call it."""
    core = (
        (f"{package}/{name}", path)
        for package in _SHARED
        for name, path in _files(package)
        if not name.startswith(_IN_NO_JOB)
    )
    found = {CORE: _digest(core)}
    # Scenarios have a digest of their own: a change of one does not repeat tasks and policies.
    if settings.scenarios:
        found[_SCENARIOS_WORDS] = _digest(_files(_SCENARIOS))
    for name in settings.backends:
        found[_backend(name)] = _plugin_digest(find_backend(name), backend_packages(name))
    jobs = [job for phase in plan(settings) for job in phase.jobs]
    for name in {job.renderer for job in jobs} - {""}:
        found[_renderer(name)] = _plugin_digest(find_renderer(name), renderer_packages(name))
    for name in {name for job in jobs for name in _solvers(job)}:
        solver = matter_solver(name)
        found[_matter(name)] = _plugin_digest(solver, _packages(solver, MATTER_SOLVERS))
    for name in settings.robots:
        # A robot's model comes from a package, whose version stands in for its files.
        packages = robot_info(name).source.split(", ")
        found[_robot(name)] = _digest((), *(f"{package} {installed_version(package)}" for package in packages))
    named = {name for job in jobs for name in sources_of(job)}
    for name in (name for name in settings.tasks if _task(name) in named):
        found[_task(name)] = _digest(_files(task_entry(name).task_type().__module__.partition(".")[0]))
    for name in settings.policies:
        found[_policy(name)] = _digest(_below(pretrained_policy(name).folder))
    return found


def sources_of(job: Job) -> set[str]:
    """The bodies of code that a job's outcome depends on, by the same words."""
    found = {CORE, _backend(job.backend)}
    # A replay depends on the backend that recorded it as well.
    if job.source:
        found.add(_backend(job.source))
    if job.renderer:
        found.add(_renderer(job.renderer))
    found |= {_matter(name) for name in _solvers(job)}
    match job.kind:
        case Kind.SCENARIO:
            found.add(_SCENARIOS_WORDS)
        case Kind.ROBOT:
            found.add(_robot(job.name))
        case Kind.TRANSFER:
            found |= {_policy(job.name), _task(learned(job.name).task)}
        case _:
            found.add(_task(job.name))
    return found


def backend_packages(name: str) -> tuple[str, ...]:
    """The Python packages of a backend's plugin: its own, and those of the distributions that it shares with others.

    A distribution is shared if the plugin's requires it and it requires ``orbit-core`` itself; its package is taken to
    be of the same name.
    """
    return _packages(find_backend(name), GROUP)


def renderer_packages(name: str) -> tuple[str, ...]:
    """The Python packages of the renderer's plugin, as :func:`backend_packages` finds them."""
    return _packages(find_renderer(name), RENDERERS if name in renderer_names() else GROUP)


def _packages(plugin: Backend | MatterSolver, group: str) -> tuple[str, ...]:
    own = type(plugin).__module__.partition(".")[0]
    (entry_point,) = importlib_metadata.entry_points(group=group, name=plugin.name)
    required = _required_by(entry_point.dist.name) if entry_point.dist else set[str]()
    shared = {each.replace("-", "_") for each in required - {"orbit-core"} if "orbit-core" in _required_by(each)}
    return (own, *sorted(package for package in shared - {own} if importlib.util.find_spec(package)))


def _required_by(distribution: str) -> set[str]:
    """Names of the distributions that a distribution requires; none where it is not installed."""
    try:
        requirements = importlib_metadata.requires(distribution) or []
    except importlib_metadata.PackageNotFoundError:
        return set()
    return {re.split(r"[^\w.-]", requirement)[0].lower() for requirement in requirements}


def _plugin_digest(plugin: Backend | MatterSolver, packages: tuple[str, ...]) -> str:
    files = (file for package in packages for file in _files(package))
    return _digest(files, *map(str, sorted(plugin.versions().items())))


def _renderer(name: str) -> str:
    return f"renderer '{name}'"


def _backend(name: str) -> str:
    return f"backend '{name}'"


def _solvers(job: Job) -> set[str]:
    """The matter solvers that a job may use: a scenario's own, and of tasks any that worlds choose by themselves."""
    if job.kind in (Kind.SCENARIO, Kind.ROBOT):
        return {job.matter} - {"", NATIVE}
    return {*matter_names()}


def _matter(name: str) -> str:
    return f"matter solver '{name}'"


def _robot(name: str) -> str:
    return f"robot '{name}'"


def _task(name: str) -> str:
    return f"task '{name}'"


def _policy(name: str) -> str:
    return f"policy '{name}'"


def _files(package: str) -> Iterator[tuple[str, Path]]:
    """The files of a package, or of a module that is one file, with their names below it."""
    spec = importlib.util.find_spec(package)
    if spec and spec.submodule_search_locations:
        for folder in spec.submodule_search_locations:
            yield from _below(Path(folder))
    elif spec and spec.origin:
        yield package, Path(spec.origin)


def _below(folder: Path) -> list[tuple[str, Path]]:
    """The files below a folder with their names below it, in order, without what Python compiled."""
    paths = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sorted((path.relative_to(folder).as_posix(), path) for path in paths)


def _digest(files: Iterable[tuple[str, Path]], *words: str) -> str:
    """The digest of names and contents."""
    digest = hashlib.sha256(repr(words).encode())
    for name, path in files:
        digest.update(f"{name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    return digest.hexdigest()
