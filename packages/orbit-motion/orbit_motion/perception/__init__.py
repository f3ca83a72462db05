"""Geometry from images: point clouds and truncated signed distance fields, in all environments at once."""

from orbit_motion.perception.nodes import (
    CloudFrame,
    DistanceSample,
    PointCloud,
    PointCloudConfig,
    PointCloudNode,
    Sampling,
    TsdfConfig,
    TsdfNode,
    TsdfVolume,
    sample_point_cloud,
)

__all__ = [
    "CloudFrame", "DistanceSample", "PointCloud", "PointCloudConfig", "PointCloudNode", "Sampling", "TsdfConfig",
    "TsdfNode", "TsdfVolume", "sample_point_cloud",
]  # fmt: skip
