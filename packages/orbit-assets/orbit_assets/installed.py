"""Robot models in installed packages."""

from __future__ import annotations

from orbit_assets.sources import model_folder
from orbit_assets.urdf import read_urdf
from orbit_core.scene import Articulation


def installed_urdf(package: str, path: str, name: str | None = None) -> Articulation:
    """The articulation of a URDF file of an installed package; ``path`` starts at the package's folder of models.

    Raises:
        AssetError: the package is not installed, or the file cannot be read.
    """
    folder = model_folder(package)
    return read_urdf(folder / path, {package: folder, package.replace("-", "_"): folder}, name)
