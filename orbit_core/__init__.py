"""ORBIT: robot-learning tasks written once, run on any physics engine.

Importing this package is light: no engine, no file format and no viewer is loaded until it is used.
"""

__version__ = "0.1.0"
