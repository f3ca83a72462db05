"""Editor of scenes in the browser, on the viewer's guarded server."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
