"""Whether a robot is the same on every engine: its mass, its links, its drives, its grip and its stand."""
