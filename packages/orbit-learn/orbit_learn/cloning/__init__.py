"""Behaviour cloning: policies learned from recorded demonstrations (``orbit train TASK --library imitation``)."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
