"""Observation, reward, event and termination functions that tasks share, and their domain randomisation."""
