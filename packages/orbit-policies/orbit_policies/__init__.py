"""Kept policies of ORBIT's tasks, a folder each; :mod:`orbit_learn.pretrained` finds them."""
