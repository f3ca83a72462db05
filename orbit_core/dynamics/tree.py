"""The shape of an articulation's tree: what hangs from what, by index."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Articulation

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]


def parent_links(articulation: Articulation) -> list[int]:
    """The parent's index of each link (L,); the root's is -1."""
    index = {name: i for i, name in enumerate(articulation.link_names)}
    parents = [-1] * len(index)
    for joint in articulation.joints:
        parents[index[joint.child]] = index[joint.parent]
    return parents


def child_links(articulation: Articulation) -> list[int]:
    """The link that each movable joint (J,) moves."""
    index = {name: i for i, name in enumerate(articulation.link_names)}
    return [index[joint.child] for joint in articulation.movable_joints]


def link_ancestry(articulation: Articulation) -> BoolArray:
    """(L, L): whether the link of the column lies on the way from the root to the link of the row, ends included."""
    parents = parent_links(articulation)
    ancestry = np.eye(len(parents), dtype=bool)
    for link, parent in enumerate(parents):
        if parent >= 0:  # links stand in topological order, so the parent's row is complete
            ancestry[link] |= ancestry[parent]
    return ancestry


def joint_ancestry(articulation: Articulation) -> BoolArray:
    """(L, J): whether the movable joint of the column moves the link of the row."""
    return link_ancestry(articulation)[:, child_links(articulation)]
