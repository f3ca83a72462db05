"""Commands of the motion library."""
