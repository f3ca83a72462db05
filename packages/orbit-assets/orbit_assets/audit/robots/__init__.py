"""Whether a catalogue entry is whole and plausible, found before the first run."""
