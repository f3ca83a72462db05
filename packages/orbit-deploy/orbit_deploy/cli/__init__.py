"""Commands of orbit-deploy."""
