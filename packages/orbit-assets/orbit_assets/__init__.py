"""Readers and writers of asset files, models of robots and objects, and audits of both. Names load on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names
from orbit_core.moved import moved_name as _moved_name

if TYPE_CHECKING:
    from orbit_assets.compose import add_frames, attach, edit_joints, edit_links, subtree
    from orbit_assets.files import asset_file, load_articulation
    from orbit_assets.sdf import read_sdf
    from orbit_assets.urdf import read_urdf, write_urdf

__all__ = [
    "add_frames", "asset_file", "attach", "edit_joints", "edit_links", "load_articulation", "read_sdf", "read_urdf",
    "subtree", "write_urdf",
]  # fmt: skip

# Readers import heavy parsers: a name is imported when it is first used, so that the catalogue starts without them.
_find, __dir__ = lazy_names(
    __name__,
    {
        "compose": ("add_frames", "attach", "edit_joints", "edit_links", "subtree"),
        "files": ("asset_file", "load_articulation"),
        "sdf": ("read_sdf",),
        "urdf": ("read_urdf", "write_urdf"),
    },
)


def __getattr__(name: str) -> object:
    return _find(name) if name in __all__ else _moved_name(__name__, name)
