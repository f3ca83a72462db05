"""Checks and simplifications of scene data before an engine sees it."""
