"""Kept policies of ORBIT's tasks, a folder each; `orbit list policies` and :mod:`orbit_learn.pretrained` find them."""
