"""Watching a simulation: a live page in the browser, pictures and videos."""
