"""Values in SDFormat's elements, which are their text, and poses, which name the frame that they are given in."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from orbit_assets.findings import Findings
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3, canonical

_TRUE, _FALSE = ("true", "1"), ("false", "0", "")


class SdfFields:
    """Reads child elements, and names file, element and remedy where one is not as it should be.

    ``where`` in all methods is the thing being read, as "link 'arm'".
    """

    def __init__(self, findings: Findings) -> None:
        self.findings = findings

    def name(self, element: Element, where: str) -> str:
        """The element's name.

        Raises:
            AssetError: it has none.
        """
        name = element.get("name")
        if not name:
            raise self.findings.error(f"{where} lacks attribute 'name' of <{element.tag}>", "add it")
        return name

    def text(self, element: Element, tag: str, where: str, default: str | None = None) -> str:
        """The text of a child element; ``default`` where there is no such child.

        Raises:
            AssetError: it is missing without a default.
        """
        child = element.find(tag)
        if child is not None:
            return (child.text or "").strip()
        if default is None:
            raise self.findings.error(f"{where} lacks <{tag}> in <{element.tag}>", "add it")
        return default

    def number(self, element: Element, tag: str, where: str, default: float | None = None) -> float:
        """The number in a child element.

        Raises:
            AssetError: it is missing without a default, or no number.
        """
        return self.numbers(element, tag, where, 1, None if default is None else repr(default))[0]

    def vector(self, element: Element, tag: str, where: str, default: str | None = None) -> Vector3:
        """The three numbers in a child element.

        Raises:
            AssetError: it is missing without a default, or not three numbers.
        """
        x, y, z = self.numbers(element, tag, where, 3, default)
        return (x, y, z)

    def numbers(self, element: Element, tag: str, where: str, count: int, default: str | None = None) -> list[float]:
        """As many numbers as asked for, from a child element, apart by spaces.

        Raises:
            AssetError: it is missing without a default, or holds another count or no numbers.
        """
        return self._parsed(self.text(element, tag, where, default), tag, where, count)

    def flag(self, element: Element, tag: str, where: str) -> bool:
        """Whether a child element says so; not where there is none.

        Raises:
            AssetError: it says neither.
        """
        text = self.text(element, tag, where, "").lower()
        if text not in (*_TRUE, *_FALSE):
            raise self.findings.error(f"{where} has <{tag}>{text}</{tag}>", "give true or false")
        return text in _TRUE

    def pose(self, element: Element, where: str) -> tuple[Pose, str]:
        """The pose that a child ``<pose>`` gives, and the name of the frame that it is given in, empty for the default.

        Raises:
            AssetError: its numbers are not as they should be.
        """
        child = element.find("pose")
        if child is None:
            return Pose(), ""
        frame = child.get("relative_to") or child.get("frame") or ""
        text = (child.text or "").strip() or "0 0 0 0 0 0"
        if child.get("rotation_format", "euler_rpy") == "quat_xyzw":
            px, py, pz, x, y, z, w = self._parsed(text, "pose", where, 7)
            return Pose((px, py, pz), canonical((w, x, y, z))), frame
        px, py, pz, roll, pitch, yaw = self._parsed(text, "pose", where, 6)
        unit = math.pi / 180.0 if child.get("degrees", "").lower() in _TRUE else 1.0
        if not (roll or pitch or yaw):
            return Pose((px, py, pz)), frame
        return Pose.from_euler(roll * unit, pitch * unit, yaw * unit, (px, py, pz)), frame

    def _parsed(self, text: str, tag: str, where: str, count: int) -> list[float]:
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count:
            raise self.findings.error(f"{where} has <{tag}>{text[:80]}</{tag}>", f"give {count} number(s)")
        return values
