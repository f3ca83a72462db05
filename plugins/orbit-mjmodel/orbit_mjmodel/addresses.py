"""The addresses of the layout's links and joints in the model."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BACKGROUND, TERRAIN, SceneLayout

Indices = npt.NDArray[np.int64]
MATTER_BODY = "matter"
"""Begins the names of bodies that are no links, but of cloth or rope."""


def body_name(link: int) -> str:
    """The body of a link of the layout."""
    return f"link{link}"


def joint_name(joint: int) -> str:
    """The joint, and the actuator, of a joint of the layout."""
    return f"joint{joint}"


@dataclass(frozen=True, eq=False)
class Addresses:
    """Indices into MuJoCo's arrays, in the layout's order."""

    bodies: Indices
    """(L,) body of each link."""
    roots: Indices
    """(L,) body that carries each link's tree, whose centre of mass is the reference point of ``cvel``."""
    joints: Indices
    """(J,) joint number."""
    joint_positions: Indices
    """(J,) into qpos."""
    joint_velocities: Indices
    """(J,) into qvel."""
    root_positions: Indices
    """(entities,) into qpos of a free root, -1 for a fixed base."""
    root_velocities: Indices
    """(entities,) into qvel of a free root, -1 for a fixed base."""
    mocaps: Indices
    """(entities,) mocap number of a fixed base, -1 for a free root."""
    link_of_geom: Indices
    """(geoms + 1,) link of each geom, TERRAIN for the world's; the last, which index -1 meets, is BACKGROUND."""
    link_of_body: Indices
    """(bodies,) link of each body, TERRAIN for the world."""

    @staticmethod
    def of(layout: SceneLayout, model: mujoco.MjModel) -> Addresses:
        bodies = np.array([model.body(body_name(link)).id for link in range(len(layout.links))], dtype=np.int64)
        joints = np.array([model.joint(joint_name(j)).id for j in range(len(layout.joints))], dtype=np.int64)
        roots = bodies[[entity.root_link for entity in layout.entities]]
        free = model.body_mocapid[roots] < 0
        first_joint = model.body_jntadr[roots]
        link_of_body = np.full(model.nbody, TERRAIN, dtype=np.int64)
        link_of_body[bodies] = np.arange(len(bodies))
        matter = [body for body in range(model.nbody) if model.body(body).name.startswith(MATTER_BODY)]
        link_of_body[matter] = BACKGROUND
        return Addresses(
            bodies=bodies,
            roots=model.body_rootid[bodies].astype(np.int64),
            joints=joints,
            joint_positions=model.jnt_qposadr[joints].astype(np.int64),
            joint_velocities=model.jnt_dofadr[joints].astype(np.int64),
            root_positions=np.where(free, model.jnt_qposadr[first_joint], -1)
            if model.njnt
            else np.full(len(roots), -1),
            root_velocities=np.where(free, model.jnt_dofadr[first_joint], -1)
            if model.njnt
            else np.full(len(roots), -1),
            mocaps=model.body_mocapid[roots].astype(np.int64),
            link_of_geom=np.append(link_of_body[model.geom_bodyid], BACKGROUND),
            link_of_body=link_of_body,
        )

    def geoms(self, link: int) -> Indices:
        """Geoms of a link, or of the terrain where ``link`` is TERRAIN."""
        return np.flatnonzero(self.link_of_geom[:-1] == link)


def columns(indices: Indices) -> slice | Indices:
    """The indices as a slice where they follow each other, which NumPy reads without copying."""
    if len(indices) and np.array_equal(indices, np.arange(indices[0], indices[0] + len(indices))):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
