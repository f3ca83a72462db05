"""Readers of data files that may come from anyone, held to one budget of bytes, pictures and seconds."""
