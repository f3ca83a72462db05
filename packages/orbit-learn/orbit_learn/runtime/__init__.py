"""Runtimes of exported policies without ORBIT: a folder with the policy, its numbers, and code in Python and C++."""

from __future__ import annotations

import json
import math
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orbit_core.actions.base import CommandMode
from orbit_core.actions.differential_ik import DifferentialIk
from orbit_core.actions.grippers import BinaryGripper
from orbit_core.actions.ik import IkMethod
from orbit_core.actions.joints import JointPosition
from orbit_core.files import written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_learn.memory import MemoryModule
from orbit_learn.runtime.cpp import cpp_header

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.actions import MotionGenerator
    from orbit_core.envs.environment import Environment
    from orbit_data.manifest.manifest import ActionTermManifest, Manifest
    from orbit_learn.policy import Policy

NAMES = ("policy.onnx", "runtime.json", "orbit_runtime.py", "orbit_runtime.hpp", "orbit_policy.hpp")
"""Files of a runtime."""
_FORMAT = 1


def write_runtime(folder: Path, policy: Policy, manifest: Manifest, environment: Environment) -> None:
    """Write a policy for use in Python (NumPy and onnxruntime) and in C++17.

    Args:
        folder: that gets the files of :data:`NAMES`.
        policy: of one robot, without memory.
        manifest: of the environment, that describes the policy's numbers.
        environment: that the policy fits, whose action terms are written.

    Raises:
        ConfigurationError: the policy remembers, sees pictures, or acts by a term that has no runtime.
    """
    document = runtime_document(policy, manifest, environment)
    with ExitStack() as stack:
        # All are written before the first takes its place, so that they belong to one policy even after an error.
        onnx, numbers, *codes, header = (stack.enter_context(written_whole(folder / name)) for name in NAMES)
        policy.export_onnx(onnx)
        numbers.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        for name, code in zip(NAMES[2:4], codes, strict=True):
            # The code travels with the file, so that a robot needs nothing of ORBIT.
            shutil.copyfile(Path(__file__).with_name(name), code)
        header.write_text(cpp_header(document), encoding="utf-8")


def runtime_document(policy: Policy, manifest: Manifest, environment: Environment) -> dict[str, Any]:
    """Return the content of ``runtime.json``.

    Raises:
        ConfigurationError: as :func:`write_runtime`.
    """
    if isinstance(policy.module, MemoryModule):
        raise ConfigurationError("a policy that remembers has no runtime yet: its file has the network alone")
    if not policy.description.concatenated:
        raise ConfigurationError(
            "a policy that sees a dictionary of terms has no runtime yet: its observation is one row"
        )
    terms = manifest.observations[policy.description.group].terms
    observations = {
        name: {
            "offset": term.offset,
            "scale": term.scale,
            "history": term.history,
            "unit": term.unit,
            "formula": term.formula,
            "frame": term.frame,
            "components": term.components,
        }
        for name, term in terms.items()
    }
    generators = zip(manifest.action_terms.items(), environment.actions.generators, strict=True)
    return {
        "format": _FORMAT,
        "task": policy.description.task,
        "robot": policy.description.robot,
        "step_dt": manifest.step_dt,
        "observations": observations,
        "actions": [_action(name, term, generator) for (name, term), generator in generators],
    }


def _action(name: str, term: ActionTermManifest, generator: MotionGenerator) -> dict[str, Any]:
    """Return the numbers that decode a term's commands."""
    common = {
        "name": name,
        "joints": term.joints,
        "components": term.components,
        "decoding": term.decoding,
        "lower": _finite(generator.lower_limits),
        "upper": _finite(generator.upper_limits),
    }
    if isinstance(generator, JointPosition):
        above, below = generator.spans
        return {
            **common,
            "kind": "joint_position",
            "mode": generator.config.mode.value,
            "home": generator.home.tolist(),
            "above": above.tolist(),
            "below": below.tolist(),
            "lead": None if generator.lead is None else _finite(generator.lead),
        }
    if isinstance(generator, BinaryGripper):
        opened, closed = generator.ends
        return {**common, "kind": "binary_gripper", "open": opened.tolist(), "closed": closed.tolist()}
    if isinstance(generator, DifferentialIk):
        config = generator.config
        if config.mode is CommandMode.RELATIVE and config.method is IkMethod.DAMPED_LEAST_SQUARES:
            return {
                **common,
                "kind": "ik_relative",
                "frame": generator.frame,
                "position_scale": config.position_scale,
                "rotation_scale": config.rotation_scale,
                "damping": config.damping,
                # JSON has no infinity, and no step is a thousand radians.
                "max_joint_step": min(config.max_joint_step, 1e3),
            }
    raise ConfigurationError(
        f"action term '{name}' ({term.generator}) has no runtime: joint_position, binary_gripper and relative "
        "differential_ik by damped least squares have one"
    )


def _finite(values: Tensor) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
