"""Rollouts: an environment stepped by an actor, with episodes counted, recorded and filmed on the way."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
