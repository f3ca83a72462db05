"""Frames of SDFormat models and worlds by name: where each stands, and the link that it moves with."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_assets.findings import Findings
from orbit_core.scene import Pose

MODEL = "__model__"
"""SDFormat's name for a model's own frame."""
WORLD = "world"
"""SDFormat's name for the frame of the world."""


@dataclass(frozen=True)
class _Given:
    """A frame as the file gives it: the pose, in frame ``relative_to``, of the frame's own part ``placement``."""

    pose: Pose
    relative_to: str
    placement: str


class SdfFrames:
    """Poses and hosts of links, joints, frames and nested models, each given in another by name, in any order.

    Args:
        findings: for errors.
        root: the frame in which all poses are computed, :data:`MODEL` or :data:`WORLD`.
    """

    def __init__(self, findings: Findings, root: str) -> None:
        self._findings = findings
        self._root = root
        self._given: dict[str, _Given] = {}
        self._hosts: dict[str, str] = {}
        self._known: dict[str, Pose] = {root: Pose()}

    def __contains__(self, name: str) -> bool:
        return name == self._root or name in self._given

    def add(self, name: str, pose: Pose, relative_to: str, placement: str = "") -> None:
        """Record where a frame stands.

        Args:
            name: of the frame.
            pose: in the frame ``relative_to``.
            relative_to: the name of a frame that may be added later.
            placement: the frame within the one added that stands at ``pose``, where it is not its origin.
        """
        self._given[name] = _Given(pose, relative_to, placement)

    def attach(self, name: str, host: str) -> None:
        """Record that a frame moves with another one, or with a link."""
        self._hosts[name] = host

    def pose(self, name: str, within: str | None = None) -> Pose:
        """Return the pose of a frame in the root, or in the frame ``within`` that it is given in, through others.

        Raises:
            AssetError: the frame, or one that it is given in, is unknown, or they form a circle.
        """
        root = within or self._root
        known = self._known if within is None else {within: Pose()}
        chain: list[str] = []
        met: set[str] = set()
        while name not in known:
            if name not in self._given:
                raise self._findings.error(f"a pose is given in frame '{name}', which does not exist", "define it")
            if name in met:
                raise self._findings.error(
                    f"the pose of '{name}' is given in itself, by way of others", "break the circle"
                )
            met.add(name)
            chain.append(name)
            name = self._given[name].relative_to
        pose = known[name]
        for each in reversed(chain):
            given = self._given[each]
            pose = pose @ given.pose
            if given.placement:
                pose = pose @ self.pose(given.placement, each).inverse()
            if root == self._root:
                self._known[each] = pose
        return pose

    def link_of(self, name: str) -> str:
        """Return the link that a frame moves with; a link, and what is unknown, as it is.

        Raises:
            AssetError: frames are attached to each other in a circle.
        """
        met: set[str] = set()
        while name in self._hosts:
            if name in met:
                raise self._findings.error(
                    f"frame '{name}' is attached to itself, by way of others", "break the circle"
                )
            met.add(name)
            name = self._hosts[name]
        return name
