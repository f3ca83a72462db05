"""Demonstrations: what environments do, recorded, kept in files that the field reads, replayed and multiplied."""
