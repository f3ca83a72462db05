"""Couplings of joints made simpler: every follower follows a joint that is free itself."""

from __future__ import annotations

from dataclasses import replace

from orbit_core.scene import Articulation, Joint, Mimic


def resolve_chains(articulation: Articulation) -> Articulation:
    """The articulation in which joints that mimic a mimic follow its leader, by the law that this amounts to.

    Laws with higher powers, circles, and leaders that do not exist are left as they are, for validation to name.
    """
    joints = {joint.name: joint for joint in articulation.joints}
    resolved = tuple(_resolved(joint, joints) for joint in articulation.joints)
    changed = [f"'{new.name}'" for old, new in zip(articulation.joints, resolved, strict=True) if new is not old]
    if not changed:
        return articulation
    note = f"joints that mimic a mimic follow its leader instead: {', '.join(changed)}"
    return replace(articulation, joints=resolved, notes=(*articulation.notes, note))


def _resolved(joint: Joint, joints: dict[str, Joint]) -> Joint:
    law, met = joint.mimic, {joint.name}
    while law is not None:
        leader = joints.get(law.joint)
        if leader is None or leader.name in met or not law.linear:
            return joint
        if leader.mimic is None or not leader.mimic.linear:
            break
        met.add(leader.name)
        offset = law.multiplier * leader.mimic.offset + law.offset
        law = Mimic(leader.mimic.joint, law.multiplier * leader.mimic.multiplier, offset)
    return joint if law is joint.mimic else replace(joint, mimic=law)
