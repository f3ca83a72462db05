"""Behaviour cloning: policies learned from recorded demonstrations (``orbit train TASK --library imitation``)."""
