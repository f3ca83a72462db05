"""The metadata of ONNX files that mjlab's exporter writes, so that code which deploys its policies reads ours.

The keys and their form are those of ``mjlab.rl.exporter_utils`` (mjlab 1.6): texts; lists are separated by commas,
numbers have three decimals, and a list in a list is separated by semicolons.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from orbit_data.manifest.manifest import Manifest, ObservationTermManifest


def deployment_metadata(manifest: Manifest, group: str, name: str) -> dict[str, str]:
    """Metadata by key for the first robot that acts; lists of joints have its order, and gain 0 without an actuator.

    ``command_names`` is empty, for commands are observation terms here. ``action_scale`` is left out where targets are
    no ``default + scale * action`` of joint positions, for there is no such number then.

    Args:
        manifest: of the environment that the policy was learned in.
        group: that the policy sees.
        name: of the run, under ``run_path``.
    """
    robot_name, robot = next((name, robot) for name, robot in manifest.robots.items() if robot.agent)
    terms = manifest.observations[group].terms
    concatenated = manifest.observations[group].concatenated
    values: dict[str, Iterable[object]] = {
        "joint_names": robot.joint_names,
        "joint_stiffness": robot.stiffness,
        "joint_damping": robot.damping,
        "default_joint_pos": robot.home_positions,
        "command_names": (),
        "observation_names": terms,
        "observation_terms_scale": [term.scale for term in terms.values()],
        "observation_terms_flatten_history_dim": [concatenated for _ in terms],
        "observation_terms_history_length": [term.history if term.history > 1 else 0 for term in terms.values()],
        "observation_terms_clip": [_clip(term) for term in terms.values()],
    }
    scales = _scales(manifest, robot_name)
    if scales:
        values["action_scale"] = scales
    return {"run_path": name, **{key: ",".join(map(_text, value)) for key, value in values.items()}}


def _scales(manifest: Manifest, robot: str) -> list[float]:
    """Scale of each component; empty where one is none of a joint's position around the default."""
    scales: list[float] = []
    for term in manifest.action_terms.values():
        if term.robot != robot or term.scale is None:
            return []
        scales += term.scale
    return scales


def _clip(term: ObservationTermManifest) -> tuple[float, float]:
    return (-math.inf if term.low is None else term.low, math.inf if term.high is None else term.high)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ";".join(map(_text, value))
    return f"{value:.3f}" if isinstance(value, int | float) else str(value)
