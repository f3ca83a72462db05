"""Scenes: procedural rooms and furniture, household things with grasps, importers of object sets, mesh scans."""
