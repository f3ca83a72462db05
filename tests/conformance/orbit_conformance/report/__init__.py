"""A result as one HTML file that opens from the disk, with its videos beside it."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
