"""Environments in the forms that learning libraries expect. Importing this gives every task its Gymnasium id.

``import orbit_core.learning`` and then ``gymnasium.make_vec("orbit/Lift-v0", num_envs=64, backend=...)``; or, in one,
``gymnasium.make_vec("orbit_core.learning:orbit/Lift-v0", ...)``.
"""

from orbit_core.learning.registration import register

register()
