"""Environments in the forms that learning libraries expect."""
