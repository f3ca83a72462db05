"""Rows of ``orbit list`` for learning libraries and kept policies."""

from __future__ import annotations

from orbit_core.cli.listing import Rows


def libraries() -> Rows:
    """Return learning libraries with what each offers."""
    from orbit_learn.learners import library_description, library_names

    return [(name, library_description(name)) for name in library_names()]


def policies() -> Rows:
    """Return kept policies with their descriptions."""
    from orbit_learn.pretrained import pretrained_policies

    return [(policy.name, policy.description) for policy in pretrained_policies().values()]
