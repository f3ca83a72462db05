"""Code that plugins may share: rotations, velocities, contact signs, markers, a scaffold for renderers.

Import from its modules: some need numpy only, and an engine's worker processes start seconds sooner without torch.
"""
