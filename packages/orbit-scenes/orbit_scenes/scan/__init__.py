"""Mesh scans of rooms made into scenes: read, cleaned, put on their floor, decimated, split into collision pieces."""

from orbit_scenes.scan.fuse import extract_surface
from orbit_scenes.scan.mesh import Scan, cleaned, cut_out, decimated, on_floor, read_scan
from orbit_scenes.scan.scene import (
    FloorMap,
    ScanCollision,
    floor_map,
    scan_object,
    scan_objects,
    scan_scene,
    voxel_boxes,
)

__all__ = [
    "FloorMap", "Scan", "ScanCollision", "cleaned", "cut_out", "decimated", "extract_surface", "floor_map", "on_floor",
    "read_scan", "scan_object", "scan_objects", "scan_scene", "voxel_boxes",
]  # fmt: skip
