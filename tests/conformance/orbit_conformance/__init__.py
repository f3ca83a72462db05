"""How right and how fast each backend is, from physics with known answers up to whole tasks."""
