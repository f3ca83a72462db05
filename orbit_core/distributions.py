"""Checks of the installed distributions: version ranges that they do not fit, and copies that hide each other."""

from __future__ import annotations

import functools
import importlib.util
import re
import site
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import importlib_metadata

from orbit_core.installing import editable_folder, install_command, upgrade_command
from orbit_core.interfaces.errors import ConfigurationError

CORE = "orbit-core"
# Distribution of ORBIT that brings most of what plugins bring under an entry-point group.
_BROUGHT_BY = {
    "orbit.tasks": "orbit-tasks",
    "orbit.robots": "orbit-assets",
    "orbit.objects": "orbit-assets",
    "orbit.decompositions": "orbit-assets",
    "orbit.motion": "orbit-motion",
    "orbit.starts": "orbit-motion",
    "orbit.recorders": "orbit-viewer",
    "orbit.policies": "orbit-policies",
    "orbit.actors": "orbit-learn",
    "orbit.actuators": "orbit-learn",
    "orbit.lists": "orbit-assets orbit-learn",
    "orbit.info": "orbit-assets",
}
_REQUIREMENT = re.compile(r"\s*(orbit[-_.][\w.-]*\w)\s*(?:\[[^\]]*\])?\s*\(?([^;()@]*)\)?\s*(?:;(.*))?$", re.IGNORECASE)
_COMPATIBLE = re.compile(r"~=\s*(\d+)\.(\d+)\.(\d+)")
_RELEASE = re.compile(r"(\d+)\.(\d+)\.(\d+)")


class DistributionWarning(UserWarning):
    """A distribution is installed more than once."""


@dataclass(frozen=True)
class _Requirement:
    """A distribution of ORBIT, or for ORBIT, that another needs."""

    name: str
    specifier: str
    """Accepted versions, such as ``"~=0.1.0"``; empty where all are."""
    extra: bool
    """Whether it is needed for an extra only."""

    def accepts(self, version: str) -> bool:
        """Return True if a version is in the range.

        Raises:
            ConfigurationError: the range is malformed.
        """
        # The form of ORBIT's own ranges, without the 60 ms that loading `packaging` costs each command.
        least, found = _COMPATIBLE.fullmatch(self.specifier), _RELEASE.fullmatch(version)
        if least and found and least.groups()[:2] == found.groups()[:2]:
            return int(found[3]) >= int(least[3])
        from packaging.specifiers import InvalidSpecifier, SpecifierSet

        try:
            return SpecifierSet(self.specifier).contains(version, prereleases=True)
        except InvalidSpecifier as error:
            raise ConfigurationError(f"'{self.specifier}' is no range of versions of {self.name}") from error

    def precedes(self, version: str) -> bool:
        """Return True if all versions of the range are older than a version that it does not accept."""
        from packaging.version import Version

        return all(Version(bound) <= Version(version) for bound in re.findall(r"\d[\w.]*", self.specifier))


@dataclass(frozen=True)
class _Installed:
    """Version of an installed distribution, and what it needs of ORBIT's."""

    version: str
    requirements: tuple[_Requirement, ...]


def check_distribution(name: str) -> None:
    """Check the version ranges between an installed distribution, those of ORBIT that it needs, and the core.

    Raises:
        ConfigurationError: a distribution is missing, too old or too new for another; names both, and the command that
            brings versions that fit.
    """
    name = _normalized(name)
    distribution, core = _installed(name), _installed(CORE)
    if distribution is None:  # run from a source tree
        return
    for requirement in core.requirements if core else ():
        if requirement.extra and requirement.name == name:
            _check(CORE, requirement, distribution)
    _check_needs(name)


def is_installed(name: str) -> bool:
    """Return True if a distribution is installed, or its package can be imported from a source tree."""
    return _installed(name) is not None or importlib.util.find_spec(_normalized(name).replace("-", "_")) is not None


def missing_note(group: str) -> str:
    """Return what is missing of ORBIT's distributions for an entry-point group, with the commands that install it.

    Empty where they are installed, or where none of ORBIT's brings anything under the group.
    """
    missing = (name for name in _BROUGHT_BY.get(group, CORE).split() if not is_installed(name))
    return "; ".join(f"the distribution {name} is not installed: {install_command(name)}" for name in missing)


@functools.cache
def warn_of_copies(name: str) -> None:
    """Warn once if a distribution is installed in more than one place, or twice in one."""
    distributions = list(importlib_metadata.distributions(name=name))
    if len(distributions) < 2:
        return
    copies: dict[tuple[Path, str], Path] = {}
    for distribution in distributions:
        place = Path(str(distribution.locate_file(""))).resolve()
        copies.setdefault((editable_folder(distribution) or place, distribution.version), place)
    # A development install may leave metadata in its source folder too, which describes the same modules.
    sources = {folder for folder, place in ((key[0], value) for key, value in copies.items()) if folder != place}
    found = {key: place for key, place in copies.items() if key[0] != place or not _is_below(place, sources)}
    if len(found) < 2:
        return
    listed = " and ".join(f"version {version} in {folder}" for folder, version in found)
    outside = [str(place) for place in found.values() if not _is_below(place, _environment())]
    uninstall = f"pip uninstall -y {name}"
    cure = (
        f"remove {' and '.join(outside)} from PYTHONPATH, or uninstall the copy there"
        if outside
        else f"{' && '.join([uninstall] * len(found))} && {install_command(name)}"
    )
    warnings.warn(
        f"distribution {name} is installed {'twice' if len(found) == 2 else f'{len(found)} times'}, {listed}, and "
        f"modules of one may be used with metadata of another: {cure}",
        DistributionWarning,
        stacklevel=2,
    )


@functools.cache
def _check_needs(name: str) -> None:
    """Check what a distribution needs, and what that needs in turn."""
    distribution = _installed(name)
    for requirement in distribution.requirements if distribution else ():
        if requirement.extra:
            continue
        needed = _installed(requirement.name)
        if needed is not None:
            _check(name, requirement, needed)
            _check_needs(requirement.name)
        elif not is_installed(requirement.name):
            raise ConfigurationError(
                f"{_label(name)} needs {requirement.name}, which is not installed: {install_command(requirement.name)}"
            )


def _check(name: str, requirement: _Requirement, needed: _Installed) -> None:
    if requirement.accepts(needed.version):
        return
    # The one that is too old is replaced: pip then brings the versions that go with the other.
    old = name if requirement.precedes(needed.version) else requirement.name
    raise ConfigurationError(
        f"{_label(name)} works with {requirement.name}{requirement.specifier}, and {requirement.name} {needed.version} "
        f"is installed: {upgrade_command(old, '' if old == name else requirement.specifier)}"
    )


def _label(name: str) -> str:
    distribution = _installed(name)
    return f"{name} {distribution.version}" if distribution else name


@functools.cache
def _installed(name: str) -> _Installed | None:
    """Read a distribution's metadata, once: parsing it takes a millisecond at each access."""
    distribution = next(iter(importlib_metadata.distributions(name=name)), None) if name else None
    if distribution is None:
        return None
    matches = filter(None, map(_REQUIREMENT.match, distribution.requires or ()))
    requirements = (
        _Requirement(_normalized(match[1]), match[2].strip(), "extra" in (match[3] or "")) for match in matches
    )
    return _Installed(distribution.version, tuple(requirements))


def _normalized(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _environment() -> set[Path]:
    """Return the folders in which pip uninstalls."""
    user = {Path(site.getusersitepackages())} if site.ENABLE_USER_SITE else set[Path]()
    return {Path(sys.prefix).resolve()} | user


def _is_below(path: Path, folders: set[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)
