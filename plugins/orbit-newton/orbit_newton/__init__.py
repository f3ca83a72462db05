"""Newton's solvers other than MuJoCo-Warp, each as a backend of its own.

Importing this package imports neither Newton nor Warp.
"""
