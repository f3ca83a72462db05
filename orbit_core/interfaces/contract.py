"""Version of the contract between the core and plugins.

A plugin states the version that it was written for, as numbers of its own: ``contract = (1, 0)``. The core checks it
when the plugin is loaded, before any engine is built.
"""

from __future__ import annotations

CONTRACT = (1, 0)
"""Version of this core, major and minor: it accepts plugins of the same major number and of no later minor number.

The major number grows with a change that breaks plugins, the minor with an addition that plugins may need.
"""


def contract_text(version: tuple[int, int]) -> str:
    """Return a version as text, such as ``"1.0"``."""
    return ".".join(map(str, version))
