"""Code that plugins may share: rotations, velocities, contact signs, markers, a scaffold for renderers.

Import from its modules: some need numpy only, and an engine's worker processes start seconds sooner without torch.
:func:`lazy_modules` is here for packages of plugins that show their modules in ``dir()`` and ``help()``.
"""

from orbit_core.exports import lazy_modules

__all__ = ["lazy_modules"]

__getattr__, __dir__ = lazy_modules(__name__)
