"""MuJoCo's own compilation of an MJCF file, and its import of a URDF file."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from orbit_assets.audit.checks import FloatArray, Posture
from orbit_assets.mjcf.model import compile_file
from orbit_assets.options import ReadOptions
from orbit_assets.source_text import one_line
from orbit_assets.xacro import read_expanded
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation


class MujocoReference:
    """MuJoCo's model of an MJCF file, seen from the description's root."""

    reader = "MuJoCo"
    """Name for the report."""

    def __init__(self, path: Path, root: str, options: ReadOptions = ReadOptions()) -> None:
        """``root`` names the description's root link.

        Raises:
            AssetError: MuJoCo refuses the file, or is not installed.
        """
        try:
            self._mujoco: Any = importlib.import_module("mujoco")
        except ImportError:
            raise AssetError(f"a comparison with MuJoCo needs the package: {install_extra('mjcf')}") from None
        try:
            self._model = self._compiled(path, options)
        except ValueError as error:
            raise AssetError(f"mujoco refuses '{path}': {one_line(str(error))}") from None
        self._data = self._mujoco.MjData(self._model)
        self._bodies = {self._body_name(body): body for body in range(self._model.nbody)}
        self._root = self._bodies.get(root, 0)
        hinges = range(self._model.njnt)
        self._simple = {self._joint_name(joint): joint for joint in hinges if self._coordinates(joint) == 1}

    # MuJoCo must not see a URDF's shapes: it refuses meshes of formats that it does not know.
    def _compiled(self, path: Path, options: ReadOptions) -> Any:
        if path.suffix.lower() != ".urdf":
            return compile_file(path, options).model
        text = urdf_without_shapes(path, options)
        if 'type="planar"' in text:
            raise AssetError(f"mujoco names the joints that a planar one becomes itself: '{path}' cannot be compared")
        return self._mujoco.MjModel.from_xml_string(text)

    @property
    def joints(self) -> frozenset[str]:
        """Names of hinges and slides."""
        return frozenset(self._simple)

    def masses(self, articulation: Articulation) -> dict[str, float]:
        """Return the mass (kg) of each link: its body's and those of all bodies welded to it."""
        hosts = {frame.name: frame.link for frame in articulation.frames} | {
            name: name for name in articulation.link_names
        }
        found: dict[str, float] = {}
        for name, body in self._bodies.items():
            if name in hosts:
                found[hosts[name]] = found.get(hosts[name], 0.0) + float(self._model.body_mass[body])
        return found

    def move(self, positions: Mapping[str, float], at: Posture) -> None:
        """Set all joints; a ball or a floating joint turns as the description's links do."""
        model, data = self._model, self._data
        data.qpos[:] = model.qpos0
        for name, joint in self._simple.items():
            if name in positions:
                data.qpos[model.jnt_qposadr[joint]] = positions[name]
        for joint in range(model.njnt):
            if self._coordinates(joint) == 3:
                self._turn(joint, at)
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_comPos(model, data)
        self._mujoco.mj_crb(model, data)

    def _turn(self, ball: int, at: Posture) -> None:
        model = self._model
        body = int(model.jnt_bodyid[ball])
        child, parent = (self._body_name(each) for each in (body, int(model.body_parentid[body])))
        if child not in at.links or parent not in at.links:
            return
        rest, turned = np.zeros(9), np.zeros(4)
        self._mujoco.mju_quat2Mat(rest, model.body_quat[body])
        # The rest orientation is taken out: ``qpos`` of a ball joint is relative to ``body_quat``.
        relative = rest.reshape(3, 3).T @ at.links[parent][:3, :3].T @ at.links[child][:3, :3]
        self._mujoco.mju_mat2Quat(turned, relative.ravel())
        start = int(model.jnt_qposadr[ball])
        self._data.qpos[start : start + 4] = turned

    def links(self) -> dict[str, FloatArray]:
        """Return poses (4, 4) of all bodies by name, in the root's frame."""
        root = np.linalg.inv(self._pose(self._root))
        return {name: root @ self._pose(body) for name, body in self._bodies.items()}

    def mass_matrix(self, joints: tuple[str, ...]) -> FloatArray:
        """Return the mass matrix by the composite rigid body algorithm, armature included."""
        full = np.zeros((self._model.nv, self._model.nv))
        self._mujoco.mj_fullM(self._model, self._data, full)
        rows = [int(self._model.jnt_dofadr[self._simple[name]]) for name in joints]
        return full[np.ix_(rows, rows)]

    def _pose(self, body: int) -> FloatArray:
        result = np.eye(4)
        result[:3, :3] = self._data.xmat[body].reshape(3, 3)
        result[:3, 3] = self._data.xpos[body]
        return result

    def _coordinates(self, joint: int) -> int:
        kinds = self._mujoco.mjtJoint
        # A free joint has 6 coordinates and a ball 3; hinges and slides have one.
        return {kinds.mjJNT_FREE: 6, kinds.mjJNT_BALL: 3}.get(kinds(self._model.jnt_type[joint]), 1)

    def _joint_name(self, joint: int) -> str:
        body = self._body_name(int(self._model.jnt_bodyid[joint]))
        return self._model.joint(joint).name or f"{body}_joint_{joint}"

    def _body_name(self, body: int) -> str:
        return self._model.body(body).name or f"body_{body}"


def urdf_without_shapes(path: Path, options: ReadOptions = ReadOptions()) -> str:
    """Return a URDF file's text without shapes, with a flag that makes MuJoCo keep fixed joints.

    Raises:
        AssetError: it is no XML.
    """
    root = read_expanded(path, options).root
    for link in root.iter("link"):
        for shape in [child for child in link if child.tag in ("visual", "collision")]:
            link.remove(shape)
    for other in [child for child in root if child.tag not in ("link", "joint")]:
        root.remove(other)
    # MuJoCo's extension of URDF; by default its importer merges links that fixed joints connect.
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    return ElementTree.tostring(root, encoding="unicode")
