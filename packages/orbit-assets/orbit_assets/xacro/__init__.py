"""Expansion of xacro files to URDF, in a process with limits, by expressions that are not Python."""

from orbit_assets.xacro.process import ExpandedXml, expand_xacro, read_expanded

__all__ = ["ExpandedXml", "expand_xacro", "read_expanded"]
