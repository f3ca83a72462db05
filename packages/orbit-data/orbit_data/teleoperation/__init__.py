"""Teleoperation: devices that a person moves, what drives a robot by them, and the episodes that are recorded so."""
