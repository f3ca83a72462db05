"""Checks that a robot is the same on every engine: its mass, links, drives, grip and stand."""
