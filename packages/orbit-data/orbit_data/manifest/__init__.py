"""Manifests: the interface between an agent and a robot, as data that a program without ORBIT can follow."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
