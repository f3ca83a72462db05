"""Watching a simulation: a live page in the browser, pictures and videos."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_viewer.viewer import Viewer, ViewerTool

__all__ = ["Viewer", "ViewerTool"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "viewer": (
            "Viewer",
            "ViewerTool",
        ),
    },
)
