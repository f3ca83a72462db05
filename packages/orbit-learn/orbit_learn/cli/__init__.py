"""Commands that train, play and export policies."""
