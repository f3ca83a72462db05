"""ORBIT: robot-learning tasks written once, run on any physics engine.

Importing this package is light: no engine, no file format and no viewer is loaded until it is used.
"""

import os

from orbit_core import moved
from orbit_core.exports import lazy_modules

__version__ = "0.1.0"

# MKL, which multiplies torch's matrices on x86-64, picks its kernels by the number of rows, so that the last bits of an
# environment would depend on how many others there are. In its strict mode they do not, at no measurable cost
# (docs/performance.md). MKL reads the variable at the process's first product; elsewhere it has no effect.
os.environ.setdefault("MKL_CBWR", "AUTO,STRICT")
moved.install()

__getattr__, __dir__ = lazy_modules(__name__)
