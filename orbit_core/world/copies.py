"""Whether the state of one world's environment can be copied into another's."""

from __future__ import annotations

from orbit_core.dynamics.arguments import whole_number
from orbit_core.interfaces import ArgumentError, UnsupportedCapabilityError, World


def check_copy(world: World, origin: World, source: int) -> None:
    """Refuse to copy environment ``source`` of ``origin`` into environments of ``world``, where that cannot be.

    Raises:
        ArgumentError: there is no such environment, or the worlds are not of one scene.
        UnsupportedCapabilityError: the scene has deformables.
    """
    whole_number(source, "source", 0, origin.num_envs - 1)
    own, other = world.layout, origin.layout
    if (other.links_by_name, other.joints_by_name) != (own.links_by_name, own.joints_by_name):
        raise ArgumentError("states are copied between worlds of one scene: the names of links and joints differ")
    if world.scene.deformables:
        raise UnsupportedCapabilityError("states of deformables are not copied: leave them out of the scene")
