"""Readers of dataset files that may come from anyone."""
