"""Functions of a few numbers per environment as one kernel: a loop on a CPU, a launch on a GPU."""

from orbit_motion.fusion.fused import Fused

__all__ = ["Fused"]
