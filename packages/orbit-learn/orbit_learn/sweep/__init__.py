"""Many trainings with varied settings, on the machines of a Ray cluster."""
