"""Bodies and the joints between them as trees, one an articulation, and the joints that close loops in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from orbit_assets.usd.contents import STAGE
from orbit_core.scene import Pose

# Types of joints that close a loop in preference to joints with one position.
_LAST = ("PhysicsSphericalJoint", "PhysicsJoint", "PhysicsFixedJoint")


@dataclass(frozen=True, eq=False)
class Edge:
    """A joint prim between two bodies, given by path, with the joint's frame in either.

    Further prims between the same bodies may act after it, each moving what the one before it carries.
    """

    prim: Any
    """Prim of the joint."""
    bodies: tuple[str, str]
    """Paths of the parent and of the child."""
    frames: tuple[Pose, Pose]
    """Joint frame in the parent and in the child."""
    closing: bool = False
    """True if the file excludes the joint from the tree."""
    flipped: bool = False
    """True if the prim names the two bodies the other way round."""
    following: tuple[Edge, ...] = ()
    """The joints that act after this one, between the same bodies in the same order."""

    @property
    def parts(self) -> tuple[Edge, ...]:
        """This joint and those that follow it, the outermost of the first body first."""
        return (self, *self.following)


@dataclass(frozen=True, eq=False)
class Tree:
    """One articulation: its bodies by path in the stage's order, :data:`STAGE` first where joints are attached to it.

    ``parent_edges`` gives for each body but the root its joint, and True if that joint runs from child to parent.
    """

    bodies: tuple[str, ...]
    """Paths of the bodies."""
    root: str
    """Path of the root body."""
    parent_edges: Mapping[str, tuple[Edge, bool]]
    loops: tuple[Edge, ...]
    """Joints that close loops."""
    fixed_base: bool
    """True if the root does not move."""


def stacked(edges: Iterable[Edge], adds: Callable[[Edge], bool]) -> list[Edge]:
    """Combine joints between the same two bodies that each add a motion, in the order given.

    Args:
        edges: joints in the stage's order.
        adds: says whether a joint adds a motion to what others between its bodies allow, and constrains nothing.
    """
    found: dict[tuple[str, ...], list[Edge]] = {}
    for number, edge in enumerate(edges):
        # A closing joint constrains its bodies and never adds a motion.
        stacks = adds(edge) and not edge.closing
        found.setdefault(tuple(sorted(edge.bodies)) if stacks else (str(number),), []).append(edge)
    return [_stack(group) for group in found.values()]


def _stack(edges: list[Edge]) -> Edge:
    first, *others = edges
    turned = (each if each.bodies == first.bodies else _flipped(each) for each in others)
    return replace(first, following=tuple(turned))


def _flipped(edge: Edge) -> Edge:
    (one, other), (frame, other_frame) = edge.bodies, edge.frames
    return replace(edge, bodies=(other, one), frames=(other_frame, frame), flipped=not edge.flipped)


class _Sets:
    """Disjoint sets of paths, joined one by one (Tarjan, Efficiency of a good but not linear set union, 1975)."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}

    def find(self, path: str) -> str:
        top = path
        while (parent := self._parents.get(top, top)) != top:
            top = parent
        # Path compression keeps look-ups short.
        while path != top:
            self._parents[path], path = top, self._parents.get(path, path)
        return top

    def join(self, first: str, second: str) -> bool:
        """Join the sets of two paths; return False if they were one set already."""
        one, other = self.find(first), self.find(second)
        self._parents[one] = other
        return one != other


def grow(bodies: Sequence[str], edges: Sequence[Edge], marked: Iterable[str]) -> list[Tree]:
    """Group bodies into trees along their joints, in the order of their first bodies.

    Args:
        bodies: paths in the stage's order.
        edges: joints; an end that does not move is :data:`STAGE`.
        marked: bodies that the file names as roots.
    """
    groups = _Sets()
    for edge in edges:
        if STAGE not in edge.bodies:
            groups.join(*edge.bodies)
    members: dict[str, list[str]] = {}
    for path in bodies:
        members.setdefault(groups.find(path), []).append(path)
    joints: dict[str, list[Edge]] = {}
    for edge in edges:
        own = edge.bodies[0] if edge.bodies[0] != STAGE else edge.bodies[1]
        # Joints to the stage do not connect trees: two robots on one floor are two articulations.
        joints.setdefault(groups.find(own), []).append(edge)
    roots = set(marked)
    return [_tree(paths, joints.get(group, []), roots) for group, paths in members.items()]


def _tree(bodies: list[str], edges: list[Edge], marked: set[str]) -> Tree:
    grounded = [edge for edge in edges if STAGE in edge.bodies]
    fixed = [edge for edge in grounded if edge.prim.GetTypeName() == "PhysicsFixedJoint" and not edge.closing]
    # One fixed joint to the world only fixes the base, and is no joint of the articulation.
    if len(grounded) == 1 and fixed:
        (base,) = (path for path in fixed[0].bodies if path != STAGE)
        edges = [edge for edge in edges if edge is not fixed[0]]
        return _spanning(bodies, edges, base if not marked.intersection(bodies) else None, marked, fixed_base=True)
    if grounded:
        return _spanning([STAGE, *bodies], edges, STAGE, marked, fixed_base=True)
    return _spanning(bodies, edges, None, marked, fixed_base=False)


def _spanning(bodies: list[str], edges: list[Edge], root: str | None, marked: set[str], *, fixed_base: bool) -> Tree:
    """Build a tree of all bodies, preferring joints with a position (Kruskal's algorithm); the rest close loops."""
    sets = _Sets()
    tree: set[int] = set()
    for edge in sorted(edges, key=_rank):
        if sets.join(*edge.bodies):
            tree.add(id(edge))
    inner = [edge for edge in edges if id(edge) in tree]
    top = root or _root(bodies, inner, marked)
    return Tree(
        tuple(bodies),
        top,
        _rooted(top, inner),
        tuple(edge for edge in edges if id(edge) not in tree),
        fixed_base,
    )


def _rank(edge: Edge) -> tuple[bool, bool]:
    return edge.closing, edge.prim.GetTypeName() in _LAST


def _root(bodies: list[str], edges: list[Edge], marked: set[str]) -> str:
    children = {edge.bodies[1] for edge in edges}
    # By preference the body that the file marks, then one that is no joint's second body.
    named = (path for path in bodies if path in marked)
    parentless = (path for path in bodies if path not in children)
    return next(named, None) or next(parentless, bodies[0])


def _rooted(root: str, edges: list[Edge]) -> dict[str, tuple[Edge, bool]]:
    """Return for each body but the root the joint that leads to it, and True if that runs from child to parent."""
    neighbours: dict[str, list[Edge]] = {}
    for edge in edges:
        for path in edge.bodies:
            neighbours.setdefault(path, []).append(edge)
    found: dict[str, tuple[Edge, bool]] = {}
    pending = [root]
    while pending:
        path = pending.pop()
        for edge in neighbours.get(path, []):
            backwards = edge.bodies[1] == path
            other = edge.bodies[0] if backwards else edge.bodies[1]
            if other != root and other not in found:
                found[other] = (edge, backwards)
                pending.append(other)
    return found
