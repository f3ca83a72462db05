"""Contract tests: every engine moves the same tensors, in the same order, units and frames.

``pytest --pyargs orbit_conformance --backend NAME`` runs them on an installed plugin.
"""
