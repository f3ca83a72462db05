"""Reader and writer of USD files."""

from orbit_assets.usd.reader import read_usd, read_usd_all
from orbit_assets.usd.writer import write_usd

__all__ = ["read_usd", "read_usd_all", "write_usd"]
