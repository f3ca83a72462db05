"""Terms and scenery that several tasks of this package share."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
