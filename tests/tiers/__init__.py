"""Tiers of the test suite: which slow tests a commit runs, and what a run reports of them (CONTRIBUTING.md)."""
