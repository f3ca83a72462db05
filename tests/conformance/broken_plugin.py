"""A distribution as a third party might install it: backends whose engine dies, and hangs, instead of being made."""

from __future__ import annotations

from pathlib import Path

_CODE = """
import os
import time
from dataclasses import dataclass

from orbit_core.interfaces import CONTRACT, EXACT, Backend, Capabilities, Capability


@dataclass(frozen=True)
class Config:
    pass


class Dying(Backend):
    name = "dying"
    contract = CONTRACT
    config_type = Config

    def capabilities(self):
        return Capabilities(dict.fromkeys(Capability, EXACT))

    def create_engine(self, layout, num_envs, device, config):
        os.abort()


class Hanging(Dying):
    name = "hanging"

    def create_engine(self, layout, num_envs, device, config):
        time.sleep(1e6)
"""
_ENTRY_POINTS = "[orbit.backends]\ndying = broken_backends:Dying\nhanging = broken_backends:Hanging\n"


def install(folder: Path) -> dict[str, str]:
    """Put it into a folder; the variable that lets Python find it there."""
    (folder / "broken_backends.py").write_text(_CODE)
    about = folder / "broken_backends-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-backends\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(_ENTRY_POINTS)
    return {"PYTHONPATH": str(folder)}
