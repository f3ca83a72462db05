"""Whether a description is the machine that its file describes: figures against other readers, and plain checks."""
