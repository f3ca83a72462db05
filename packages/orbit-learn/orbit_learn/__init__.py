"""Environments in the forms that learning libraries expect. Importing this gives every task its Gymnasium id.

``import orbit_learn`` and then ``gymnasium.make_vec("orbit/Lift-v0", num_envs=64, backend=...)``; or, in one,
``gymnasium.make_vec("orbit_learn:orbit/Lift-v0", ...)``.
"""

from orbit_learn.registration import register

register()
