"""Scripted experts: phases of a task, executed by a motion planner or straight pursuit of poses."""

from orbit_motion.experts.expert import Expert, Phase, Retry

__all__ = ["Expert", "Phase", "Retry"]
