"""Evaluation of policies on the same starts, over engines and disturbances (``orbit evaluate``)."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
