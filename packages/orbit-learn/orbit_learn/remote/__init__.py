"""Policies behind a socket: any policy server as an agent, and any of our policies as a server (OpenPI's protocol)."""
