"""Bounding boxes in pictures and in space."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import transform_points


@dataclass(frozen=True)
class BoundingBoxes2d:
    """Boxes of E entities in the pictures of N environments.

    A box is (left, top, right, bottom) in pixels from the image's top left corner, where the pixel in column c and row
    r reaches from c to c + 1 and from r to r + 1. What is not in the picture has a box of zeros.
    """

    names: tuple[str, ...]
    """(E,) of the entities."""
    semantic_labels: tuple[str, ...]
    """(E,) of each entity's root link."""
    tight: Tensor
    """(N, E, 4) around the pixels that show the entity: what hides it, and the image's edge, make the box smaller."""
    visible: Tensor
    """(N, E) bool: whether any pixel shows the entity."""
    pixels: Tensor
    """(N, E) int64: how many pixels show it."""
    loose: Tensor
    """(N, E, 4) around the projection of the whole entity, as if nothing hid it, cut off at the image's edge.

    Exact for boxes, balls, capsules, cylinders and meshes in front of the camera's near plane; of a shape that reaches
    through that plane, the part in front of it of the box around the shape.
    """
    in_view: Tensor
    """(N, E) bool: whether the loose box and the image overlap."""
    visible_share: Tensor
    """(N, E) in [0, 1]: the tight box's area over that of the loose box before the image's edge cuts it.

    It is 1, but for the rounding to whole pixels, where the entity's outline is wholly seen. It compares boxes and not
    outlines: what covers the middle of an entity, and leaves its ends free, goes unnoticed.
    """


@dataclass(frozen=True)
class BoundingBoxes3d:
    """Oriented boxes of B entities, or links, in N environments."""

    names: tuple[str, ...]
    """(B,) of the entities, or "entity/link" of links."""
    semantic_labels: tuple[str, ...]
    """(B,)"""
    poses: Tensor
    """(N, B, 7): the box's centre, and the orientation of the entity's root link, or of the link."""
    half_extents: Tensor
    """(N, B, 3) in metres along the box's own axes."""

    @property
    def corners(self) -> Tensor:
        """(N, B, 8, 3): from (-, -, -) to (+, +, +), z changing fastest."""
        number, place = (torch.arange(n, device=self.poses.device) for n in (8, 3))
        signs = ((number[:, None] >> (2 - place)) & 1) * 2.0 - 1.0
        return transform_points(self.poses[..., None, :], signs * self.half_extents[..., None, :])


def least(values: Tensor, groups: Tensor, count: int) -> Tensor:
    """The least of ``values`` (N, P, k) in each of ``count`` groups (N, P): (N, count, k), infinite in empty groups.

    Waits for nothing, and sizes depend on no values.
    """
    found = torch.full((len(values), count, values.shape[-1]), torch.inf, device=values.device)
    return found.scatter_reduce_(1, groups[..., None].expand_as(values), values, "amin")


def pixel_boxes(instances: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Boxes (N, count, 4) around the pixels of each instance 0 to count - 1, and how many pixels there are (N, count).

    Args:
        instances: (N, H, W, 1) which instance each pixel shows; negative for none.
        count: how many instances there are.
    """
    height, width = instances.shape[1:3]
    column = torch.arange(width, device=instances.device, dtype=torch.float32).repeat(height)
    row = torch.arange(height, device=instances.device, dtype=torch.float32).repeat_interleave(width)
    sides = torch.stack((column, row, -(column + 1), -(row + 1)), -1).expand(len(instances), -1, -1)
    shown = instances.flatten(1).to(torch.int64)
    shown = torch.where(shown < 0, count, shown)  # what is no instance goes to a group of its own, dropped below
    boxes = _upright(least(sides, shown, count + 1)[:, :count])
    pixels = torch.zeros(len(shown), count + 1, dtype=torch.int64, device=shown.device)
    return boxes, pixels.scatter_add_(1, shown, torch.ones_like(shown))[:, :count]


def projected_boxes(slopes: Tensor, groups: Tensor, count: int, intrinsics: Tensor) -> Tensor:
    """Boxes (N, count, 4) in pixels, not cut off, of what spans ``slopes``; zeros for groups of which nothing is seen.

    Args:
        slopes: (N, P, 4) left, top, right and bottom as x / depth and y / depth, y downwards; left and top infinite,
            and right and bottom minus infinite, where nothing is seen.
        groups: (N, P) int64.
        count: how many groups there are.
        intrinsics: (3, 3) of the camera.
    """
    scale = torch.stack((intrinsics[0, 0], intrinsics[1, 1])).repeat(2)
    offset = torch.stack((intrinsics[0, 2], intrinsics[1, 2])).repeat(2)
    sides = slopes * scale + offset
    return _upright(least(torch.cat((sides[..., :2], -sides[..., 2:]), -1), groups, count))


def cut_off(boxes: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Boxes (N, E, 4) cut off at the image's edge, zero beyond it, and whether anything is left (N, E)."""
    cut = torch.stack((boxes[..., 0::2].clamp(0.0, width), boxes[..., 1::2].clamp(0.0, height)), -1).flatten(-2)
    in_view = area(cut) > 0.0
    return torch.where(in_view[..., None], cut, 0.0), in_view


def area(boxes: Tensor) -> Tensor:
    """(N, E) of boxes (N, E, 4)."""
    return (boxes[..., 2] - boxes[..., 0]) * (boxes[..., 3] - boxes[..., 1])


def _upright(sides: Tensor) -> Tensor:
    """Boxes of (left, top, -right, -bottom), zeros where these are infinite."""
    boxes = torch.cat((sides[..., :2], -sides[..., 2:]), -1)
    return torch.where(sides.isfinite().all(-1, keepdim=True), boxes, 0.0)
