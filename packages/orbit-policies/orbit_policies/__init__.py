"""Kept policies of ORBIT's tasks, a folder each; :mod:`orbit_core.pretrained` finds them."""
