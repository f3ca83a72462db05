"""One tree of links chosen from a description that holds several."""

from __future__ import annotations

from dataclasses import replace

from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation


def choose_tree(articulation: Articulation, root: str | None) -> Articulation:
    """The part of a description that hangs on the link ``root``, with that link's name; all of it for ``None``.

    Raises:
        AssetError: no root is named, and there are several.
        UnknownNameError: no root has that name.
    """
    children = {joint.child for joint in articulation.joints}
    roots = [link.name for link in articulation.links if link.name not in children]
    if root is None:
        if len(roots) > 1:
            listed = ", ".join(f"'{name}'" for name in roots[:8])
            raise AssetError(
                f"'{articulation.name}': there are several roots, {listed}: connect them with joints, or name one by "
                "ReadOptions(articulation=...)"
            )
        return articulation
    if roots == [root] or (len(roots) == 1 and root == articulation.name):
        return articulation
    if root not in roots:
        raise UnknownNameError("articulation", root, roots, f"'{articulation.name}'")
    return _tree(articulation, root)


def _tree(articulation: Articulation, root: str) -> Articulation:
    followers: dict[str, list[str]] = {}
    for joint in articulation.joints:
        followers.setdefault(joint.parent, []).append(joint.child)
    kept, stack = {root}, [root]
    while stack:
        for child in followers.get(stack.pop(), []):
            if child not in kept:
                kept.add(child)
                stack.append(child)
    return replace(
        articulation,
        name=root,
        links=tuple(link for link in articulation.links if link.name in kept),
        joints=tuple(joint for joint in articulation.joints if joint.child in kept),
        loops=tuple(loop for loop in articulation.loops if kept.issuperset((loop.first, loop.second))),
        frames=tuple(frame for frame in articulation.frames if frame.link in kept),
        collision_exclusions=tuple(pair for pair in articulation.collision_exclusions if kept.issuperset(pair)),
        notes=(*articulation.notes, f"the file holds other articulations beside '{root}'"),
    )
