"""Scripted experts: phases of a task that a motion planner or a pursuit carries out."""

from orbit_motion.experts.expert import Expert, Phase, Retry

__all__ = ["Expert", "Phase", "Retry"]
