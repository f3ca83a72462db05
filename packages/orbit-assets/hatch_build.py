"""Puts ORBIT's own asset files, which lie at the root of the checkout, into the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class AssetFiles(BuildHookInterface[Any]):
    """Adds the files where the build runs in a checkout; a source archive has them in the package."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files to include."""
        files = Path(self.root).parents[1] / "assets"
        if version != "editable" and (files / "cabinet.usda").exists():
            build_data["force_include"][str(files)] = "orbit_assets/files"
