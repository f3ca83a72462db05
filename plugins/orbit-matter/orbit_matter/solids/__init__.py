"""Elastic solids: any closed surface embedded in a coarse grid of quadratic hexahedra, stepped implicitly."""
