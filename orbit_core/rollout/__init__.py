"""Rollouts: an environment stepped by an actor, with episodes counted, recorded and filmed on the way."""
