"""Geometry from images: point clouds and truncated signed distance fields, in all environments at once."""

from orbit_motion.perception.clouds import PointCloud, PointCloudConfig, Sampling, sample_point_cloud
from orbit_motion.perception.nodes import CloudFrame, PointCloudNode, TsdfNode
from orbit_motion.perception.tsdf import DistanceSample, TsdfConfig, TsdfVolume

__all__ = [
    "CloudFrame", "DistanceSample", "PointCloud", "PointCloudConfig", "PointCloudNode", "Sampling", "TsdfConfig",
    "TsdfNode", "TsdfVolume", "sample_point_cloud",
]  # fmt: skip
