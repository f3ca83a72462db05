"""Batched torch: frames and rotations, kinematics and dynamics of articulations."""
