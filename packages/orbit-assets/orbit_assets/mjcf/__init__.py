"""Reader and writer of MJCF files."""

from orbit_assets.mjcf.reader import read_mjcf, read_mjcf_all
from orbit_assets.mjcf.writer import write_mjcf

__all__ = ["read_mjcf", "read_mjcf_all", "write_mjcf"]
