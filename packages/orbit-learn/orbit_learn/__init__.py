"""Environments in the forms that learning libraries expect. Importing this gives every task its Gymnasium id.

``import orbit_learn`` and then ``gymnasium.make_vec("orbit/Lift-v0", num_envs=64, backend=...)``; or, in one,
``gymnasium.make_vec("orbit_learn:orbit/Lift-v0", ...)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names
from orbit_learn.registration import register_when_imported

if TYPE_CHECKING:
    from orbit_learn.description import PolicyDescription
    from orbit_learn.gymnasium import SingleEnvironment, VectorEnvironment
    from orbit_learn.learners import library_names, trainer_type
    from orbit_learn.onnx_file import read_onnx, write_onnx
    from orbit_learn.pettingzoo import ParallelEnvironment
    from orbit_learn.policy import Policy, load_policy, whole_agent
    from orbit_learn.policy_file import register_network
    from orbit_learn.trainer import Trainer
    from orbit_learn.training import Training

__all__ = [
    "ParallelEnvironment",
    "Policy",
    "PolicyDescription",
    "SingleEnvironment",
    "Trainer",
    "Training",
    "VectorEnvironment",
    "library_names",
    "load_policy",
    "read_onnx",
    "register_network",
    "trainer_type",
    "whole_agent",
    "write_onnx",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "description": ("PolicyDescription",),
        "gymnasium": (
            "SingleEnvironment",
            "VectorEnvironment",
        ),
        "learners": (
            "library_names",
            "trainer_type",
        ),
        "policy_file": ("register_network",),
        "onnx_file": (
            "read_onnx",
            "write_onnx",
        ),
        "pettingzoo": ("ParallelEnvironment",),
        "policy": (
            "Policy",
            "load_policy",
            "whole_agent",
        ),
        "trainer": ("Trainer",),
        "training": ("Training",),
    },
)

register_when_imported()
