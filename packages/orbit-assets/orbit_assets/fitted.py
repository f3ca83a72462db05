"""Robots of the catalogue with parameters that were fitted to a recorded motion, in a JSON file with their source."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orbit_core.files import read_bytes, written_whole
from orbit_core.interfaces.errors import AssetError

if TYPE_CHECKING:
    from orbit_core.scene import ActuatorConfig, Link, RobotSpec

FORMAT = "orbit.fitted_robot/1"
"""Format of the files that this module reads and writes."""
JOINT_QUANTITIES = ("friction", "damping", "armature")
"""Fields of :class:`~orbit_core.scene.Joint` that are fitted, in N m, N m s/rad and kg m^2, or N, N s/m and kg."""


@dataclass(frozen=True, kw_only=True)
class FittedRobot:
    """Parameters of one robot on one engine."""

    robot: str
    """Name in the catalogue."""
    source: str
    """Log that they were fitted to."""
    backend: str = ""
    """Engine that they were fitted on: friction of another engine may be another law."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Fitted quantities of :data:`JOINT_QUANTITIES` by joint."""
    payload_link: str = ""
    """Link that carries the payload."""
    payload: float = 0.0
    """Mass that is added to a link at its centre of mass, kg; the link's inertia grows by the same factor."""
    gain: float = 1.0
    """Factor of the drives' stiffness and damping, as of a motor constant that is off."""
    delay: float = 0.0
    """Seconds between a target and its effect. The robot's specification has no such field: those who send targets
    delay them (``orbit robot``, ``orbit twin``)."""
    deviations: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of each fitted number by its name, such as ``friction:joint1``."""
    rms_before: float = math.nan
    """Root mean square of simulated minus recorded positions with the catalogue's parameters, rad or m."""
    rms: float = math.nan
    """The same with these parameters."""

    def apply(self, spec: RobotSpec) -> RobotSpec:
        """Return a robot with these parameters.

        Raises:
            AssetError: it lacks a joint or a link.
        """
        articulation = spec.articulation
        missing = [name for name in self.joints if name not in articulation.joint_names]
        if self.payload and self.payload_link not in [link.name for link in articulation.links]:
            missing.append(self.payload_link)
        if missing:
            raise AssetError(f"robot '{articulation.name}' lacks {', '.join(missing)}, whose parameters were fitted")
        joints = tuple(replace(each, **self.joints.get(each.name, {})) for each in articulation.joints)
        links = tuple(self._loaded(link) for link in articulation.links)
        actuators = tuple(self._geared(group) for group in spec.actuators)
        return replace(spec, articulation=replace(articulation, joints=joints, links=links), actuators=actuators)

    def write(self, path: Path) -> None:
        """Write the file."""
        document = {"format": FORMAT, **asdict(self)}
        # JSON has no infinity: what is not known is null.
        document["deviations"] = {name: _known(value) for name, value in self.deviations.items()}
        document |= {"rms_before": _known(self.rms_before), "rms": _known(self.rms)}
        with written_whole(path) as file:
            file.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")

    def _loaded(self, link: Link) -> Link:
        if link.name != self.payload_link or not self.payload:
            return link
        factor = (link.mass + self.payload) / link.mass
        return replace(link, mass=link.mass * factor, inertia=link.inertia * factor)

    def _geared(self, group: ActuatorConfig) -> ActuatorConfig:
        if self.gain == 1.0:
            return group
        return replace(group, stiffness=group.stiffness * self.gain, damping=group.damping * self.gain)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def read_fitted(path: Path) -> FittedRobot:
    """Read the file of a fitted robot.

    Raises:
        AssetError: it is none, or holds something else than numbers.
    """
    try:
        document: dict[str, Any] = json.loads(read_bytes(path))
        if not isinstance(document, dict) or document.pop("format", None) != FORMAT:
            raise AssetError(f'{path} is no fitted robot: it lacks "format": "{FORMAT}"')
        unknown = set(document) - {each.name for each in fields(FittedRobot)}
        if unknown:
            raise AssetError(f"{path} holds fields that a fitted robot has not: {', '.join(sorted(unknown))}")
        document["deviations"] = {name: _number(value) for name, value in document.get("deviations", {}).items()}
        document |= {name: _number(document.get(name)) for name in ("rms_before", "rms")}
        found = FittedRobot(**document)
        values = [value for each in found.joints.values() for value in each.values()]
        numbers = [*values, found.payload, found.gain, found.delay]
        wrong = {name for each in found.joints.values() for name in each} - set(JOINT_QUANTITIES)
        if wrong:
            raise AssetError(f"{path} fits {', '.join(sorted(wrong))} of joints, not {', '.join(JOINT_QUANTITIES)}")
        if not all(isinstance(value, int | float) and 0.0 <= value < math.inf for value in numbers):
            raise AssetError(f"{path} holds a parameter that is negative or no finite number")
    except (ValueError, TypeError, AttributeError) as error:
        raise AssetError(f"{path} is no fitted robot: {error}") from None
    return found
