"""Readers and writers of asset files, models of robots and objects, and audits of both. Names load on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from orbit_core.moved import moved_name

if TYPE_CHECKING:
    from orbit_assets.compose import add_frames, attach, edit_joints, edit_links, subtree
    from orbit_assets.files import asset_file, load_articulation
    from orbit_assets.sdf import read_sdf
    from orbit_assets.urdf import read_urdf, write_urdf

# Readers import heavy parsers: a name is imported when it is first used, so that the catalogue starts without them.
_MODULES = {
    "compose": ("add_frames", "attach", "edit_joints", "edit_links", "subtree"),
    "files": ("asset_file", "load_articulation"),
    "sdf": ("read_sdf",),
    "urdf": ("read_urdf", "write_urdf"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "add_frames", "asset_file", "attach", "edit_joints", "edit_links", "load_articulation", "read_sdf", "read_urdf",
    "subtree", "write_urdf",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        return moved_name(__name__, name)
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
