"""Pictures that the surfaces of links carry, each environment its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture that is repeated over the surfaces of a link, in the link's frame, as if each side were a wall.

    A point takes the colour that the picture has there when it is laid on the two axes of the frame that the surface
    faces least, its middle at the origin; on upright sides its rows run downwards. Colours multiply the surface's own:
    what is white shows the picture as it is.
    """

    pixels: npt.NDArray[np.uint8]
    """(H, W, 3) red, green and blue, the uppermost row first."""
    width: float = 0.2
    """Metres that its width spans; its height follows from the shape of ``pixels``."""

    def __post_init__(self) -> None:
        """Look at the numbers.

        Raises:
            ValueError: pixels of another shape or type, or none; a width that is not above zero.
        """
        pixels = self.pixels
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8 or pixels.size == 0:
            raise ValueError(f"a texture's pixels are (H, W, 3) of uint8, not {pixels.shape} of {pixels.dtype}")
        if not 0.0 < self.width < np.inf:
            raise ValueError(f"a texture's width must be above zero metres, not {self.width:g}")

    @property
    def height(self) -> float:
        """Metres that its height spans."""
        return self.width * self.pixels.shape[0] / self.pixels.shape[1]
