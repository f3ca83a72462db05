"""Observations that no policy can take are refused, with the term and the environments named."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.envs.observation_layout import GroupLayout, Observation
from orbit_core.interfaces import NonFiniteError, first_few


def check_finite(observation: Observation, layouts: Mapping[str, GroupLayout]) -> None:
    """Refuse numbers that are NaN or infinite; this waits for the device.

    Raises:
        NonFiniteError: names group, term, environments and component.
    """
    for name, group in observation.items():
        layout = layouts[name]
        if isinstance(group, dict):
            for term, value in group.items():
                if not _finite(value):
                    _refuse(name, term, value.flatten(1))
        elif not surely_finite(group):
            for term, columns in layout.columns.items():
                _refuse(name, term, group[:, columns])


def _finite(value: Tensor) -> bool:
    """Whether all numbers are finite, for sure: a sum that overflows says no, and is looked into."""
    return not value.is_floating_point() or surely_finite(value)


def surely_finite(values: Tensor) -> bool:
    """Return True if all numbers are finite; False where one is not, or where their sum overflows."""
    if values.device.type != "cpu":
        return math.isfinite(float(values.sum()))
    # NumPy's product in the tensor's own memory: on few numbers it costs a third of torch's sum, and warns of nothing.
    flat = values.numpy().reshape(-1)
    return math.isfinite(flat.dot(flat))


def _refuse(group: str, term: str, values: Tensor) -> None:
    """Raise where one of the values (N, D) of a term is not finite."""
    wrong = ~torch.isfinite(values)
    environments = wrong.any(1).nonzero().squeeze(-1).tolist()
    if not environments:
        return
    component = int(wrong[environments[0]].nonzero()[0])
    number = float(values[environments[0], component])
    plural = "s" if len(environments) > 1 else ""
    raise NonFiniteError(
        f"observation term '{term}' of group '{group}' is not finite in environment{plural} "
        f"{first_few(environments)}: component {component} of environment {environments[0]} is {number}. A term must "
        "give finite numbers: bound what divides or measures, as orbit_core.mdp.images.camera_depth does"
    )
