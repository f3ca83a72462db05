"""Newton's solvers other than MuJoCo-Warp, each as a separate backend.

Importing this package imports neither Newton nor Warp.
"""
