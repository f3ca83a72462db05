"""Numbers, vectors and names in the attributes of XML elements, each with an error that says where it stands."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from orbit_assets.findings import Findings
from orbit_core.scene.pose import Vector3


class Fields:
    """Reads attributes and child elements, and names file, element and remedy where one is not as it should be.

    ``where`` in all methods is the thing being read, as "joint 'elbow'".
    """

    def __init__(self, findings: Findings) -> None:
        self.findings = findings

    def attribute(self, element: Element, key: str, where: str) -> str:
        """The attribute's text.

        Raises:
            AssetError: it is missing.
        """
        value = element.get(key)
        if value is None:
            raise self.findings.error(f"{where} lacks attribute '{key}' of <{element.tag}>", "add it")
        return value

    def child(self, element: Element, tag: str, where: str) -> Element:
        """The first child element with the tag.

        Raises:
            AssetError: it is missing.
        """
        child = element.find(tag)
        if child is None:
            raise self.findings.error(f"{where} lacks <{tag}> in <{element.tag}>", "add it")
        return child

    def number(self, element: Element, key: str, where: str, default: float | None = None) -> float:
        """The number in an attribute; ``default`` where it is missing.

        Raises:
            AssetError: it is missing without a default, or no number.
        """
        if default is not None and element.get(key) is None:
            return default
        return self.numbers(element, key, where, 1)[0]

    def vector(self, element: Element, key: str, where: str, default: Vector3 | None = None) -> Vector3:
        """The three numbers in an attribute; ``default`` where it is missing.

        Raises:
            AssetError: it is missing without a default, or not three numbers.
        """
        if default is not None and element.get(key) is None:
            return default
        x, y, z = self.numbers(element, key, where, 3)
        return (x, y, z)

    def numbers(self, element: Element, key: str, where: str, count: int) -> list[float]:
        """As many numbers as asked for, from an attribute, apart by spaces.

        Raises:
            AssetError: it is missing, or holds another count or no numbers.
        """
        text = self.attribute(element, key, where)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count:
            raise self.findings.error(f'{where} has {key}="{text}" in <{element.tag}>', f"give {count} number(s)")
        return values
