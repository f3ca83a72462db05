"""Evaluation of policies on the same starts, over engines and disturbances (``orbit evaluate``)."""
