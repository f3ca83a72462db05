"""Captured functions: tensor operations and calls to an engine that are traced once, compiled, and replayed."""
