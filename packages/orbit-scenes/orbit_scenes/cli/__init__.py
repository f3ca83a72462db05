"""Commands of orbit-scenes."""
