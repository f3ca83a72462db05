"""Agents on real robots: what every bridge shares."""
