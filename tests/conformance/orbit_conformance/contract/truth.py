"""Measured against true, with an error that says both and which way it is off."""

from __future__ import annotations

import torch
from torch import Tensor


def assert_near(measured: Tensor, truth: Tensor, *, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Every element within ``atol + rtol |truth|``; NaN never is.

    Raises:
        AssertionError: names the element that is furthest off, what was measured, the truth, by how much it is above
            or below, and what was allowed.
    """
    measured, truth = torch.broadcast_tensors(measured.detach().cpu().double(), truth.detach().cpu().double())
    allowed = atol + rtol * truth.abs()
    excess = ((measured - truth).abs() - allowed).nan_to_num(nan=torch.inf)
    if not excess.numel() or not (excess > 0.0).any():
        return
    place = tuple(int(i) for i in torch.unravel_index(excess.argmax(), excess.shape))
    got, true = float(measured[place]), float(truth[place])
    way = "not a number" if got != got else f"{abs(got - true):.4g} {'above' if got > true else 'below'}"
    count = int((excess > 0.0).sum())
    raise AssertionError(
        f"element {list(place)} is {got:.7g}, {way} the truth {true:.7g} where {float(allowed[place]):.3g} is allowed; "
        f"{count} of {excess.numel()} elements are off"
    )
