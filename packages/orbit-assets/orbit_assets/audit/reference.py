"""Pinocchio's reading of a URDF file, and the distance of a description from the result of another reader."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from orbit_assets.audit.checks import FloatArray, Posture, mass_matrix, posture
from orbit_assets.options import ReadOptions
from orbit_assets.xacro import read_expanded
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation

# Every audit of a file uses the same postures, so that two reports can be compared.
_SEED = 0
# Radians or metres from zero within which joints without limits are moved.
_REACH = 2.0


class Reference(Protocol):
    """A model that another reader made of the same file."""

    @property
    def reader(self) -> str:
        """The reader's name, for tables."""
        ...

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints with one coordinate, by which it can be moved as the description is."""
        ...

    def masses(self, articulation: Articulation) -> Mapping[str, float]:
        """Return mass in kg by link of the description, which is without fixed joints."""
        ...

    def move(self, positions: Mapping[str, float], at: Posture) -> None:
        """Take a posture: its own joints of one coordinate by name, all others as the description's links stand."""
        ...

    def links(self) -> Mapping[str, FloatArray]:
        """Return poses (4, 4) of links and fixed frames by name, in the root's frame."""
        ...

    def mass_matrix(self, joints: tuple[str, ...]) -> FloatArray:
        """Return the mass matrix (J, J) of the joints named, all else held."""
        ...


@dataclass(frozen=True)
class Comparison:
    """The largest differences between a description and another reader's model of the same file."""

    reader: str
    """Name of the other reader."""
    mass: float
    """Of a link, in kg."""
    kinematics: float
    """Of a link's origin, in metres, over random postures."""
    rotation: float
    """Of an entry of a link's rotation matrix, over random postures."""
    mass_matrix: float
    """Of an entry (i, j), relative to the root of the product of diagonal entries i and j."""
    links: int
    """How many links were compared."""
    joints: int
    """How many joints were compared."""


def compare(articulation: Articulation, reference: Reference, postures: int = 3) -> Comparison:
    """Compare a description with a reference in random postures, the same at each call.

    Args:
        articulation: the description, its fixed joints merged or not.
        reference: another reader's model of the same file.
        postures: number of random postures.
    """
    merged = merge_fixed_links(articulation)
    generator = np.random.default_rng(_SEED)
    masses = reference.masses(merged)
    mass = max((abs(link.mass - masses[link.name]) for link in merged.links if link.name in masses), default=0.0)
    names = tuple(name for name in merged.joint_names if name in reference.joints)
    kinematics = rotation = inertia = 0.0
    compared: set[str] = set()
    for _ in range(postures):
        positions = _random_positions(merged, generator)
        at = posture(merged, positions)
        reference.move(positions, at)
        own, other = {**at.frames, **at.links}, reference.links()
        compared = own.keys() & other.keys()
        for name in compared:
            difference = np.abs(own[name] - other[name])
            kinematics = max(kinematics, float(np.linalg.norm(difference[:3, 3])))
            rotation = max(rotation, float(difference[:3, :3].max()))
        rows = [merged.joint_names.index(name) for name in names]
        inertia = max(inertia, _relative(mass_matrix(merged, at)[np.ix_(rows, rows)], reference.mass_matrix(names)))
    return Comparison(reference.reader, mass, kinematics, rotation, inertia, len(compared), len(names))


def _random_positions(articulation: Articulation, generator: np.random.Generator) -> dict[str, float]:
    positions: dict[str, float] = {}
    for joint in articulation.movable_joints:
        lower, upper = np.clip((joint.lower_limit, joint.upper_limit), -_REACH, _REACH)
        positions[joint.name] = float(generator.uniform(min(lower, upper), max(lower, upper)))
    return positions


# Entries are scaled by the diagonal, so that light joints count as much as heavy ones.
def _relative(own: FloatArray, other: npt.NDArray[np.float64]) -> float:
    if not own.size:
        return 0.0
    scale = np.sqrt(np.maximum(np.diag(other), 1e-9))
    return float((np.abs(own - other) / np.outer(scale, scale)).max())


def pinocchio_installed() -> bool:
    """Return True if Pinocchio (the package pin) is installed."""
    return importlib.util.find_spec("pinocchio") is not None


def _text(path: Path, options: ReadOptions) -> str:
    """Return the file's own text, unless it holds macros, which Pinocchio passes over, or is not written in UTF-8."""
    expanded = read_expanded(path, options)
    with contextlib.suppress(UnicodeDecodeError):
        if not expanded.notes:
            return path.read_bytes().decode("utf-8")
    return ElementTree.tostring(expanded.root, encoding="unicode")


class PinocchioReference:
    """Pinocchio's model of a URDF file, its root fixed and followers free."""

    reader = "pinocchio"
    """Name for the report."""

    def __init__(self, path: Path, options: ReadOptions = ReadOptions()) -> None:
        """Raises AssetError where Pinocchio refuses the file."""
        self._pin: Any = importlib.import_module("pinocchio")
        try:
            self._model = self._pin.buildModelFromXML(_text(path, options))
        except (ValueError, RuntimeError, IndexError) as error:
            raise AssetError(f"pinocchio refuses '{path}': {' '.join(str(error).split())}") from None
        self._data = self._model.createData()
        self._simple = {
            str(name): index
            for index, name in enumerate(self._model.names)
            if index and self._model.joints[index].nv == 1
        }

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints with one coordinate."""
        return frozenset(self._simple)

    def masses(self, articulation: Articulation) -> dict[str, float]:
        """Return the mass (kg) of the links behind each joint; the root's are in the universe's inertia."""
        model = self._model
        found = {articulation.root.name: float(model.inertias[0].mass)}
        for joint in articulation.joints:
            if joint.name in self._simple:
                found[joint.child] = float(model.inertias[self._simple[joint.name]].mass)
        return found

    def move(self, positions: Mapping[str, float], at: Posture) -> None:
        """Set all joints; one with several coordinates takes what its own frames say."""
        pin, model = self._pin, self._model
        q = pin.neutral(model)
        placed: list[Any] = [pin.SE3.Identity()] * model.njoints
        for index in range(1, model.njoints):
            joint = model.joints[index]
            before = placed[model.parents[index]] * model.jointPlacements[index]
            part = slice(joint.idx_q, joint.idx_q + joint.nq)
            if str(model.names[index]) in positions:
                q[part] = self._coordinate(joint, positions[str(model.names[index])])
            else:
                q[part] = self._coordinates(joint, before.inverse() * self._child(index, at))
            # Forward kinematics after each joint: the next one's own frame depends on it.
            pin.forwardKinematics(model, self._data, q)
            placed[index] = self._data.oMi[index]
        pin.framesForwardKinematics(model, self._data, q)
        self._q = q

    def _coordinate(self, joint: Any, position: float) -> list[float]:
        # Pinocchio gives a joint without limits as cosine and sine.
        return [np.cos(position), np.sin(position)] if joint.nq == 2 else [position]

    def _coordinates(self, joint: Any, pose: Any) -> FloatArray:
        rotation = self._pin.Quaternion(pose.rotation).coeffs()
        if joint.nq == 4 and joint.nv == 3 and "Planar" in joint.shortname():
            yaw = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
            return np.array([*pose.translation[:2], np.cos(yaw), np.sin(yaw)])
        return np.concatenate([pose.translation, rotation]) if joint.nq == 7 else np.asarray(rotation)

    def _child(self, index: int, at: Posture) -> Any:
        frames = (frame for frame in self._model.frames if frame.parentJoint == index)
        body = next(frame for frame in frames if frame.type == self._pin.FrameType.BODY)
        known = {**at.frames, **at.links}
        return self._pin.SE3(known[body.name]) * body.placement.inverse()

    def links(self) -> dict[str, FloatArray]:
        """Return poses (4, 4) of all bodies by name, in the root's frame."""
        frames = enumerate(self._model.frames)
        return {
            str(frame.name): np.asarray(self._data.oMf[index].homogeneous)
            for index, frame in frames
            if frame.type == self._pin.FrameType.BODY
        }

    def mass_matrix(self, joints: tuple[str, ...]) -> FloatArray:
        """Return the mass matrix by the composite rigid body algorithm."""
        full = np.asarray(self._pin.crba(self._model, self._data, self._q))
        # ``crba`` fills the upper triangle only.
        full = np.triu(full) + np.triu(full, 1).T
        rows = [self._model.joints[self._simple[name]].idx_v for name in joints]
        return full[np.ix_(rows, rows)]
