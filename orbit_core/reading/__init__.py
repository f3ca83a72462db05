"""Readers of data files that may come from anyone, held to one budget of bytes, pictures and seconds."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
