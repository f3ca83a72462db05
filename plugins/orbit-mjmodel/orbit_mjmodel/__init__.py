"""ORBIT's scenes as MuJoCo models, for the backends that step or draw them.

Importing this package does not import MuJoCo.
"""

from orbit_mjmodel.config import ModelConfig

__all__ = ["ModelConfig"]
