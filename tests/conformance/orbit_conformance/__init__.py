"""Conformance suite: accuracy and speed of each backend, from physics with known answers up to whole tasks."""
