"""MuJoCo's actuators in a USD stage: gains and effort limits of the joints that they drive."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from orbit_assets.actuator_law import ActuatorLaw, Range
from orbit_assets.usd.stage import Reading, array, attribute, label, number, targets
from orbit_core.scene import DriveGains, Joint

_NONE = (-math.inf, math.inf)
_SHOWN = 8
"""Names that a note lists; it counts the rest."""


class Actuators:
    """The ``MjcActuator`` prims of a stage, by the joint prim that each drives.

    Args:
        prims: the actuators.
        joints: the stage's joints.
        reading: the file; actuators that drive no joint are noted.

    Raises:
        AssetError: a number of an actuator is none.
    """

    def __init__(self, prims: Sequence[Any], joints: Collection[Any], reading: Reading) -> None:
        paths = {str(joint.GetPath()) for joint in joints}
        self._laws: dict[str, list[tuple[str, ActuatorLaw]]] = {}
        left: list[str] = []
        for prim in prims:
            (target, *_) = targets(prim, "mjc:target") or [""]
            if target in paths:
                self._laws.setdefault(target, []).append((label(prim), _law(prim)))
            else:
                left.append(label(prim))
        if left:
            reading.note(f"actuators that drive no joint are left out: {_some(left)}")

    def limited(self, joint: Joint, prim: Any, reading: Reading) -> Joint:
        """Return the joint with the effort limit that its own range and all its actuators together leave it."""
        path = str(prim.GetPath())
        low, high = _sum(law for _, law in self._laws[path]) if path in self._laws else _NONE
        own = _range(prim, "actuatorfrclimited", "actuatorfrcrange") or _NONE
        low, high = max(low, own[0]), min(high, own[1])
        most = max(-low, high)
        if not math.isclose(-low, high, rel_tol=1e-6):
            reading.note(
                f"the effort limit of joint '{joint.name}' differs by direction, {low:.4g} to {high:.4g}: "
                f"{most:.4g} holds in both"
            )
        return replace(joint, effort_limit=min(most, joint.effort_limit))

    def drives(self, names: Mapping[str, str], driven: Collection[str], reading: Reading) -> list[DriveGains]:
        """Return the gains of joints that have actuators; those of several actuators add up.

        Args:
            names: names of an articulation's joints with one position, by the paths of their prims.
            driven: joints that have a drive of UsdPhysics, which counts.
            reading: the file, for notes on what is left out.
        """
        found: list[DriveGains] = []
        left: list[str] = []
        for path in names:
            laws = self._laws.get(path, [])
            if laws and names[path] in driven:
                reading.note(f"joint '{names[path]}' has a drive of UsdPhysics, which counts, besides an actuator")
                continue
            left += [called for called, law in laws if law.gains() is None]
            known = [(law, gains) for _, law in laws if (gains := law.gains()) is not None]
            if known:
                low, high = _sum(law for law, _ in known)
                stiffness, damping = (sum(values) for values in zip(*(gains for _, gains in known), strict=True))
                found.append(DriveGains(names[path], stiffness, damping, max(-low, high)))
        if left:
            reading.note(f"actuators that are no spring and damper on one joint are left out: {_some(left)}")
        return found


def _law(prim: Any) -> ActuatorLaw:
    gear = array(prim, "mjc:gear", 1, float)
    return ActuatorLaw(
        gain_type=str(attribute(prim, "mjc:gainType", "fixed")),
        bias_type=str(attribute(prim, "mjc:biasType", "none")),
        dynamics=str(attribute(prim, "mjc:dynType", "none")),
        gain=_parameters(prim, "mjc:gainPrm", 1.0),
        bias=_parameters(prim, "mjc:biasPrm", 0.0),
        gear=float(gear[0]) if len(gear) else 1.0,
        force_range=_range(prim, "forceLimited", "forceRange"),
        command_range=_range(prim, "ctrlLimited", "ctrlRange"),
    )


def _parameters(prim: Any, name: str, first: float) -> tuple[float, ...]:
    """The first three of an actuator's parameters, the schema's where the file gives none."""
    given = [float(value) for value in array(prim, name, 1, float)[:3]] or [first]
    return (*given, *(0.0,) * (3 - len(given)))


def _range(prim: Any, limited: str, name: str) -> Range | None:
    """A range of MuJoCo's, if it acts: where it is said to, or where nothing is said and there is one."""
    word = str(attribute(prim, f"mjc:{limited}", "auto"))
    low, high = (number(prim, f"mjc:{name}:{end}") for end in ("min", "max"))
    return (low, high) if word == "true" or (word == "auto" and low != high) else None


def _sum(laws: Iterable[ActuatorLaw]) -> Range:
    """The least and the largest effort of actuators that act together."""
    lows, highs = zip(*(law.effort_range() for law in laws), strict=True)
    return sum(lows), sum(highs)


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:_SHOWN])
    return shown + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
