"""Rows of ``orbit list`` for robots and objects."""

from __future__ import annotations

from orbit_assets.catalogue import robot_info, robot_names
from orbit_core.cli.listing import Rows


def robots() -> Rows:
    """Return the robots of the catalogue with their descriptions."""
    return [(name, robot_info(name).description) for name in robot_names()]


def objects() -> Rows:
    """Return the kinds of objects with their descriptions."""
    from orbit_core.objects import object_kinds

    return [*object_kinds().descriptions.items()]
