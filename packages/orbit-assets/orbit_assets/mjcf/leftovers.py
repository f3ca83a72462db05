"""What an MJCF model has that its articulation cannot hold, beyond joints and constraints."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbit_assets.mjcf.model import Compiled
from orbit_assets.mjcf.trees import Tree

_SOLREF, _SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's own for a contact or a limit."""
_GRAVITY = (0.0, 0.0, -9.81)


def meet_leftovers(compiled: Compiled, tree: Tree) -> None:
    """Note what is the scene's or the engine's to say, and meet what changes how the bodies move.

    Raises:
        AssetError: the options have what the description cannot hold refused.
    """
    _meet_bodies(compiled, tree)
    _note_contact(compiled, tree)
    _note_surroundings(compiled)
    model = compiled.model
    counts = {
        "tendons": model.ntendon,
        "contact pairs": model.npair,
        "sensors": model.nsensor,
        "cameras": model.ncam,
        "skins": model.nskin,
        "textures": model.ntex,
        "joints whose springs and limits are soft (solref, solimp or margin)": _soft_joints(model),
    }
    compiled.notes += [f"{what} are left out: {count}" for what, count in counts.items() if count]


def _meet_bodies(compiled: Compiled, tree: Tree) -> None:
    model, bodies = compiled.model, list(tree.bodies)
    if model.nflex:
        compiled.unsupported(f"there are {model.nflex} flexes, which are deformable", "remove them")
    floating = [body for body in bodies if model.body_gravcomp[body]]
    if floating:
        compiled.unsupported(f"gravity is compensated on bodies {compiled.listed(floating)}", "remove gravcomp")
    if plugged := [body for body in bodies if model.body_plugin[body] >= 0]:
        compiled.unsupported(f"a plugin of MuJoCo acts on bodies {compiled.listed(plugged)}", "remove the plugin")


def _note_contact(compiled: Compiled, tree: Tree) -> None:
    model = compiled.model
    ours = np.isin(model.geom_bodyid, tree.bodies)
    solid = ours & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    of = {
        "solref or solimp": _unlike(model.geom_solref, _SOLREF) | _unlike(model.geom_solimp, _SOLIMP),
        "a margin or gap": (model.geom_margin != 0) | (model.geom_gap != 0),
        "a priority or solmix": (model.geom_priority != 0) | (model.geom_solmix != 1),
    }
    for what, rows in of.items():
        if count := int(np.sum(rows & solid)):
            compiled.notes.append(f"{what} of geoms is left out: {count}")


def _note_surroundings(compiled: Compiled) -> None:
    """Options of the world, which are the scene's to say."""
    option = compiled.model.opt
    said = {
        "gravity": not np.allclose(option.gravity, _GRAVITY, atol=0.01),
        "the medium's density, viscosity or wind": bool(option.density or option.viscosity or np.any(option.wind)),
        "overridden contact": bool(option.enableflags & int(compiled.mujoco.mjtEnableBit.mjENBL_OVERRIDE)),
        "what the file disables": bool(option.disableflags),
    }
    if left := [what for what, is_said in said.items() if is_said]:
        compiled.notes.append(f"options that are the scene's to say are left out: {', '.join(left)}")


def _soft_joints(model: Any) -> int:
    soft = _unlike(model.jnt_solref, _SOLREF) | _unlike(model.jnt_solimp, _SOLIMP) | (model.jnt_margin != 0)
    return int(np.sum(soft & (model.jnt_limited != 0)))


def _unlike(rows: Any, default: tuple[float, ...]) -> np.ndarray:
    return ~np.all(np.isclose(rows, default), axis=1)
