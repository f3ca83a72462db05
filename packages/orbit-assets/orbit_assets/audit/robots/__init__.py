"""Audit of a catalogue entry: checks that it is complete and plausible, before the first run."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
