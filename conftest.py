"""Settings of every test run: the tiers of slow tests."""

pytest_plugins = ["tests.tiers.plugin"]
