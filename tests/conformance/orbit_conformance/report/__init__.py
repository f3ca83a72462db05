"""A result as one HTML file that opens from the disk, with its videos next to it."""
