"""Audit of asset files and robots: comparison with other readers of a format, and checks of plausibility."""
