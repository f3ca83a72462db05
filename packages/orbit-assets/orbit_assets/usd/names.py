"""Names that no two things share, made of what a stage calls them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping


def unique_names(labels: Mapping[str, str], taken: frozenset[str] = frozenset()) -> dict[str, str]:
    """A name for each path: its label, or where several would have that one, with names of the prims above before it.

    Where even whole paths do not tell them apart, numbers do.

    Args:
        labels: by path, in the order in which the first keeps the shorter name where numbers are needed.
        taken: names that none may have.
    """
    names = dict(labels)
    parts = {path: [part for part in path.split("/")[1:-1] if part] for path in labels}
    shared = _shared(names, taken)
    depth = 0
    while shared and any(len(parts[path]) > depth for path in shared):
        depth += 1
        for path in shared:
            names[path] = "_".join((*parts[path][-depth:], labels[path]))
        shared = _shared(names, taken)
    used = {name for path, name in names.items() if path not in shared} | taken
    for path in shared:
        number, name = 1, names[path]
        while name in used:
            number, name = number + 1, f"{names[path]}_{number + 1}"
        names[path] = name
        used.add(name)
    return names


def _shared(names: Mapping[str, str], taken: frozenset[str]) -> list[str]:
    counts = Counter(names.values())
    return [path for path, name in names.items() if counts[name] > 1 or name in taken]
