"""Policies behind a socket: any policy server as an agent, and any of our policies as a server (OpenPI's protocol)."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
