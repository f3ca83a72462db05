"""Files to scene data and back, and the catalogues of robots and objects. Names load on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orbit_assets.compose import add_frames, attach, edit_joints, edit_links, subtree
    from orbit_assets.files import asset_file, load_articulation
    from orbit_assets.sdf import read_sdf
    from orbit_assets.urdf import read_urdf, write_urdf
    from orbit_core.objects import ObjectConfig, object_config, object_kinds
    from orbit_core.preparation.merge import merge_fixed_links
    from orbit_core.preparation.validation import sort_links, validate, validate_entity
    from orbit_core.robots import RobotCatalogue, RobotEntry, robot, robot_info, robot_names

_MODULES = {
    "catalogue": ("RobotCatalogue", "RobotEntry", "robot", "robot_info", "robot_names"),
    "compose": ("add_frames", "attach", "edit_joints", "edit_links", "subtree"),
    "files": ("asset_file", "load_articulation"),
    "merge": ("merge_fixed_links",),
    "object_kinds": ("ObjectConfig", "object_config", "object_kinds"),
    "sdf": ("read_sdf",),
    "urdf": ("read_urdf", "write_urdf"),
    "validation": ("sort_links", "validate", "validate_entity"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "ObjectConfig", "RobotCatalogue", "RobotEntry", "add_frames", "asset_file", "attach", "edit_joints",
    "edit_links", "load_articulation", "merge_fixed_links", "object_config", "object_kinds", "read_sdf", "read_urdf",
    "robot", "robot_info", "robot_names", "sort_links", "subtree", "validate", "validate_entity", "write_urdf",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
