"""The one place that imports SAPIEN."""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    # Importing it complains where no Vulkan loader is installed, which physics does not need.
    warnings.simplefilter("ignore")
    import sapien
    import sapien.physx as physx

from orbit_core.scene import Pose

NativePose = sapien.Pose


def native_pose(pose: Pose) -> sapien.Pose:
    """The same pose as SAPIEN's; both hold (w, x, y, z)."""
    return sapien.Pose(list(pose.position), list(pose.orientation))


__all__ = ["NativePose", "native_pose", "physx", "sapien"]
