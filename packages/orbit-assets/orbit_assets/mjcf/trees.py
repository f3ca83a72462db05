"""Trees of bodies of a compiled MJCF model, each of which makes an articulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbit_assets.mjcf.model import Compiled
from orbit_core.interfaces.errors import AssetError

WORLD = "world"
"""Name, among the articulations of a file, of the tree of all bodies that are attached to the world."""


@dataclass(frozen=True)
class Tree:
    """Connected bodies, the root first and parents before children; root 0 is the world."""

    bodies: tuple[int, ...]
    """Numbers of the bodies in MuJoCo's model."""
    floating: bool = False
    """True if the root moves freely."""
    world_geoms: bool = False
    """True if the shapes of the world belong to it; only where the world is its root."""

    @property
    def root(self) -> int:
        """Body that carries all others."""
        return self.bodies[0]


class Trees:
    """Bodies right below the world, each with its descendants."""

    def __init__(self, compiled: Compiled) -> None:
        model = compiled.model
        self.compiled = compiled
        """Compiled model."""
        below = np.asarray(model.body_rootid)
        # Bodies of a flex's vertices are cloth, not links.
        cloth = set(model.flex_vertbodyid.tolist()) - {-1} if model.nflex else set()
        top = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0 and body not in cloth]
        # Bodies of motion capture have no dynamics.
        self.mocap = [body for body in top if model.body_mocapid[body] >= 0]
        """Bodies that a program moves, which no physics does."""
        self.top = [body for body in top if body not in set(self.mocap)]
        """Other bodies right below the world."""
        self.members: dict[int, list[int]] = {body: [] for body in self.top}
        """All bodies below each of those, itself first."""
        for body, root in enumerate(below.tolist()):
            if root in self.members and body not in cloth:
                self.members[root].append(body)
        self.floating = [body for body in self.top if self._floats(body)]
        """Those whose root moves freely."""
        self.hanging = [body for body in self.top if not self._floats(body)]
        """Those that the world holds."""
        solid = compiled.model.geom_bodyid == 0
        kinds = compiled.mujoco.mjtGeom
        terrain = np.isin(model.geom_type, (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)))
        self.world_has_shapes = bool(np.any(solid & ~terrain))
        """True if the world has solid shapes other than terrain."""
        self.world_has_terrain = bool(np.any(solid & terrain))
        """True if the world has planes or height fields."""

    def one(self) -> Tree:
        """Return the articulation that the options name, or the only one.

        Raises:
            AssetError: there is none, of that name or at all, or there are several and none is named.
        """
        wanted = self.compiled.options.articulation
        tree = self._only() if wanted is None else self._named(wanted)
        left = [body for body in self.top if body not in set(tree.bodies)]
        if left:
            self.compiled.notes.append(f"other bodies of the file are left out: {self.compiled.listed(left)}")
        if self.mocap:
            self.compiled.notes.append(
                f"bodies moved by motion capture are left out: {self.compiled.listed(self.mocap)}"
            )
        if tree.root == 0:
            self.compiled.notes.append(
                "link 'world', without mass, replaces the world that bodies are attached to: fix the base"
            )
        return tree

    def every(self) -> list[Tree]:
        """Return all trees of the file: one per body below the world, one for bodies held together, and the world
        itself.
        """
        trees = [Tree((0,), world_geoms=True)] if self.world_has_shapes or self.world_has_terrain else []
        for group in self._groups():
            if len(group) == 1:
                trees.append(self._tree(group[0]))
            else:
                trees.append(Tree((0, *(body for top in group for body in self.members[top]))))
        return trees

    def _only(self) -> Tree:
        if self.floating:
            first = self.floating[0]
            if len(self.floating) > 1 or any(self._moves(body) for body in self.hanging):
                raise AssetError(f"{self.compiled.path} holds several articulations: {self._choices()}")
            return self._tree(first)
        if len(self.top) == 1 and not self.world_has_shapes and not self.compiled.model.body_jntnum[self.top[0]]:
            return self._tree(self.top[0])
        if not self.top and not self.world_has_shapes:
            raise AssetError(f"{self.compiled.path} holds no body: give it one")
        return self._world()

    def _named(self, name: str) -> Tree:
        if name == WORLD and (self.hanging or self.world_has_shapes):
            return self._world()
        for body in self.top:
            if self.compiled.body_names[body] == name:
                return self._tree(body)
        raise AssetError(f"{self.compiled.path} holds no articulation '{name}': {self._choices()}")

    def _choices(self) -> str:
        top = f"{self.compiled.listed(self.top)}, or '{WORLD}' for all that does not float"
        return f"name one by ReadOptions(articulation=...), {top}"

    def _world(self) -> Tree:
        return Tree((0, *(body for top in self.hanging for body in self.members[top])), world_geoms=True)

    def _tree(self, top: int) -> Tree:
        if self._floats(top):
            return Tree(tuple(self.members[top]), floating=True)
        if self.compiled.model.body_jntnum[top]:
            return Tree((0, *self.members[top]))
        return Tree(tuple(self.members[top]))

    def _floats(self, body: int) -> bool:
        return any(self.compiled.joint_kind(joint) == "FREE" for joint in self.compiled.joints_of(body))

    def _moves(self, top: int) -> bool:
        return any(self.compiled.model.body_jntnum[body] for body in self.members[top])

    def _groups(self) -> list[list[int]]:
        """Group the bodies below the world; bodies attached to it that a constraint connects form one group."""
        group_of = {top: [top] for top in self.top}
        for first, second in self._connected():
            if group_of[first] is not group_of[second] and not (self._floats(first) or self._floats(second)):
                joined = group_of[first] + group_of[second]
                group_of.update(dict.fromkeys(joined, joined))
        return [list(group) for group in dict.fromkeys(tuple(sorted(group)) for group in group_of.values())]

    def _connected(self) -> list[tuple[int, int]]:
        model, kinds = self.compiled.model, self.compiled.mujoco.mjtObj
        bodies_of = {int(kinds.mjOBJ_SITE): model.site_bodyid, int(kinds.mjOBJ_JOINT): model.jnt_bodyid}
        pairs: list[tuple[int, int]] = []
        for index in range(model.neq):
            kind, first, second = int(model.eq_objtype[index]), int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
            # Sites and joints name their bodies indirectly.
            known = bodies_of.get(kind)
            if min(first, second) < 0 or (known is None and kind != int(kinds.mjOBJ_BODY)):
                continue
            ends = (first, second) if known is None else (int(known[first]), int(known[second]))
            roots = [int(model.body_rootid[end]) for end in ends]
            if all(root in self.members for root in roots):
                pairs.append((roots[0], roots[1]))
        return pairs
