"""Code that engines written in Warp share: recorded launches, contact queries, optional arrays, common kernels.

Importing this package does not import Warp.
"""

from orbit_core.plugin_kit import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
