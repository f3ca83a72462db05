"""Bad calls over the public API: `pytest tests/fuzz --calls 2000` makes as many on every installed backend."""
