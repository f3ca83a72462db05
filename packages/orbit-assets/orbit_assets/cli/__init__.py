"""Commands on asset files and robots."""
