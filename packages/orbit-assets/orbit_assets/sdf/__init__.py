"""Reader of SDFormat files."""

from orbit_assets.sdf.reader import read_sdf, read_sdf_models

__all__ = ["read_sdf", "read_sdf_models"]
