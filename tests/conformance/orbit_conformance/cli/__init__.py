"""The command that runs the suite."""
