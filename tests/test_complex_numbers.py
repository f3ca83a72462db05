"""Complex numbers are nowhere taken for their real part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from orbit_core.configuration import TypeChecker
from orbit_core.interfaces import ArgumentError


@dataclass
class Heights:
    """A field of heights."""

    heights: npt.NDArray[Any]


@pytest.mark.parametrize("values", [np.ones(3, np.complex64), np.array(["a"]), np.ones(3, bool)])
def test_an_array_of_a_scene_holds_real_numbers(values: npt.NDArray[Any]) -> None:
    TypeChecker().check(Heights(np.ones(3)), "field")
    with pytest.raises(ArgumentError, match="an array of real numbers"):
        TypeChecker().check(Heights(values), "field")
