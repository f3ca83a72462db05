"""Actuator models that are fitted to recordings of real joints."""
