"""Audit of a catalogue entry: checks that it is complete and plausible, before the first run."""
