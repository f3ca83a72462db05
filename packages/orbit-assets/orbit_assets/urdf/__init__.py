"""Reader and writer of URDF files."""

from orbit_assets.urdf.reader import read_urdf
from orbit_assets.urdf.writer import write_urdf

__all__ = ["read_urdf", "write_urdf"]
