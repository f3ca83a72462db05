"""ORBIT's own distributions but the plugins: where each one's package is, and which others it may import."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Distribution:
    """A distribution with one package."""

    package: str
    """Import name."""
    folder: str
    """Path of the package below the root of the checkout."""
    needs: frozenset[str] = field(default_factory=frozenset)
    """Packages that any of its modules may import."""
    optional: frozenset[str] = field(default_factory=frozenset)
    """Packages that those of its modules import which are of use with them alone."""

    @property
    def files(self) -> list[Path]:
        """All Python files of the package, sorted."""
        return sorted((ROOT / self.folder).rglob("*.py"))


_CORE = frozenset({"orbit_core"})
_VIEWER = frozenset({"orbit_viewer"})
DISTRIBUTIONS = (
    Distribution("orbit_core", "orbit_core"),
    Distribution("orbit_assets", "packages/orbit-assets/orbit_assets", _CORE),
    Distribution("orbit_motion", "packages/orbit-motion/orbit_motion", _CORE | {"orbit_assets"}, _VIEWER),
    Distribution("orbit_learn", "packages/orbit-learn/orbit_learn", _CORE | {"orbit_data"}),
    Distribution("orbit_data", "packages/orbit-data/orbit_data", _CORE, _VIEWER | {"orbit_motion"}),
    Distribution("orbit_viewer", "packages/orbit-viewer/orbit_viewer", _CORE),
    Distribution(
        "orbit_deploy",
        "packages/orbit-deploy/orbit_deploy",
        _CORE | {"orbit_assets", "orbit_data"},
        frozenset({"orbit_learn", "orbit_viewer"}),
    ),
    Distribution("orbit_scenes", "packages/orbit-scenes/orbit_scenes", _CORE | {"orbit_assets"}, _VIEWER),
    Distribution("orbit_zmq", "bridges/orbit-zmq/orbit_zmq", _CORE | {"orbit_deploy"}),
    Distribution("orbit_ros", "bridges/orbit-ros/orbit_ros", _CORE | {"orbit_assets", "orbit_deploy"}),
    Distribution("orbit_policies", "packages/orbit-policies/orbit_policies"),
    Distribution("orbit_tasks", "orbit_tasks", _CORE | {"orbit_assets", "orbit_motion", "orbit_learn"}),
    Distribution(
        "orbit_conformance",
        "tests/conformance/orbit_conformance",
        _CORE | {"orbit_assets", "orbit_data", "orbit_learn"},
    ),
)


def module_of(path: PurePosixPath) -> str:
    """Return the full name of the module that a path below the root is; empty if it is in none of these packages."""
    if path.suffix != ".py":
        return ""
    for distribution in DISTRIBUTIONS:
        if path.is_relative_to(distribution.folder):
            inside = path.relative_to(PurePosixPath(distribution.folder).parent)
            return ".".join(inside.with_suffix("").parts).removesuffix(".__init__")
    return ""
