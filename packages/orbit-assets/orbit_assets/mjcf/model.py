"""An MJCF model as MuJoCo compiled it, with names for everything and a list of what its reading has to say."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.mjcf.files import read_whole
from orbit_assets.naming import one_line
from orbit_assets.options import ReadOptions, Unsupported
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3, canonical

PARSER = "mujoco"
"""The package that reads MJCF."""
_UNNAMED = "MuJoCo Model"
"""The name that MuJoCo gives to a model without one."""


@dataclass(eq=False)
class Compiled:
    """One compiled model; what is not taken over as it is becomes a line of ``notes``, or an error."""

    model: Any
    mujoco: Any
    path: Path
    name: str
    options: ReadOptions
    notes: list[str] = field(default_factory=list)

    def unsupported(self, what: str, remedy: str) -> None:
        """Meet something that the description cannot hold, as the options say.

        Raises:
            AssetError: the options have it refused.
        """
        if self.options.unsupported is Unsupported.REFUSE:
            raise AssetError(
                f"{self.path}: {what}: {remedy}, or have it left out by ReadOptions(unsupported=Unsupported.DROP)"
            )
        self.notes.append(f"left out: {what}")

    @cached_property
    def body_names(self) -> list[str]:
        """Names of all bodies, the world's first; those without one are called by their number."""
        return _filled(self.names_of("BODY"), [f"body_{index}" for index in range(self.model.nbody)])

    @cached_property
    def joint_names(self) -> list[str]:
        """Names of all joints; those without one are called by their body and number."""
        bodies = [self.body_names[body] for body in self.model.jnt_bodyid]
        return _filled(self.names_of("JOINT"), [f"{body}_joint_{index}" for index, body in enumerate(bodies)])

    @cached_property
    def site_names(self) -> list[str]:
        """Names of all sites, none of them a body's."""
        names = _filled(self.names_of("SITE"), [f"site_{index}" for index in range(self.model.nsite)])
        bodies = set(self.body_names)
        return [f"{name}_site" if name in bodies else name for name in names]

    @cached_property
    def geom_names(self) -> list[str]:
        """Names of all geoms, as the file gives them: a name may be empty."""
        return self.names_of("GEOM")

    def names_of(self, kind: str) -> list[str]:
        """The file's names of all objects of one kind, such as ``"TENDON"``; empty where it gives none."""
        counts = {
            "BODY": "nbody", "JOINT": "njnt", "SITE": "nsite", "GEOM": "ngeom", "EQUALITY": "neq", "TENDON": "ntendon",
            "ACTUATOR": "nu", "KEY": "nkey",
        }  # fmt: skip
        number = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}")
        count = getattr(self.model, counts[kind])
        return [self.mujoco.mj_id2name(self.model, number, index) or "" for index in range(count)]

    def joints_of(self, body: int) -> range:
        """The body's joints, the outermost first."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def joint_kind(self, joint: int) -> str:
        """``FREE``, ``BALL``, ``SLIDE`` or ``HINGE``."""
        return self.mujoco.mjtJoint(self.model.jnt_type[joint]).name.removeprefix("mjJNT_")

    def body_pose(self, body: int) -> Pose:
        """Pose of a body in its parent, where all joints are at their references."""
        return pose_of(self.model.body_pos[body], self.model.body_quat[body])

    def listed(self, bodies: list[int]) -> str:
        """The bodies' names, a few of them where there are many."""
        names = ", ".join(f"'{self.body_names[body]}'" for body in bodies[:12])
        return names if len(bodies) <= 12 else f"{names} and {len(bodies) - 12} more"


def compile_file(path: Path, options: ReadOptions) -> Compiled:
    """Compile an MJCF file, once it is known to ask for nothing that the options forbid.

    Raises:
        AssetError: the file does not compile, opens or makes what the options forbid, or MuJoCo is not installed.
    """
    try:
        mujoco: Any = importlib.import_module(PARSER)
    except ImportError:
        raise AssetError(f"MJCF files need the package {PARSER}: {install_extra('mjcf')}") from None
    whole = read_whole(path, options)
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)  # else it writes them to the terminal and to a file in the folder at hand
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spec = mujoco.MjSpec.from_string(whole.text, include=whole.models)
            spec.modelfiledir = str(path.parent)
            model = spec.compile()
    except ValueError as error:
        raise AssetError(f"{path} does not compile: {one_line(str(error))}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    name = spec.modelname if spec.modelname != _UNNAMED else path.stem
    return Compiled(model, mujoco, path, name, options, [f"MuJoCo: {one_line(line)}" for line in said])


def _filled(names: list[str], fallback: list[str]) -> list[str]:
    """The names, with the fallback where one is empty, made longer until it is nobody else's."""
    taken = set(names)
    result: list[str] = []
    for name, own in zip(names, fallback, strict=True):
        while not name and own in taken:
            own += "_"
        taken.add(name or own)
        result.append(name or own)
    return result


def pose_of(position: Any, quaternion: Any) -> Pose:
    """The pose of arrays (3,) and (4,)."""
    w, x, y, z = (float(value) for value in quaternion)
    return Pose(vector_of(position), canonical((w, x, y, z)))


def vector_of(values: Any) -> Vector3:
    """Three numbers as Python's."""
    x, y, z = np.asarray(values).tolist()
    return (x, y, z)
