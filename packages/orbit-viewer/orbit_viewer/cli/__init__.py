"""The command that shows a task live."""
