"""Composition of articulations: attach one to another, cut a part out, and edit joints, links and frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

from orbit_assets.mass_properties import shapes_mass_properties
from orbit_assets.meshes import simplified_hull
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.interfaces.names import match_names
from orbit_core.preparation.validation import check_structure
from orbit_core.scene import Articulation, Frame, Joint, JointType, Link, LoopJoint, Mesh, Pose, Shape


def attach(
    base: Articulation, other: Articulation, at: str, pose: Pose | None = None, prefix: str = ""
) -> Articulation:
    """Return ``base`` with the root of ``other`` fixed to it.

    The result collides with itself if either part does; links of a part that does not collide with itself still do not
    collide with each other.

    Args:
        base: the articulation that carries the other.
        other: the articulation to attach.
        at: link or frame of ``base``.
        pose: of the root of ``other`` in ``at``; the same pose by default.
        prefix: put before every name of ``other``.

    Raises:
        UnknownNameError: ``base`` has no such link or frame.
        AssetError: names clash.
    """
    mount = _frame(base, at)
    other = renamed(other, lambda name: prefix + name) if prefix else other
    self_collisions = base.self_collisions or other.self_collisions
    # One flag holds for the whole articulation: a part without self-collision keeps that by exclusions.
    if self_collisions:
        base, other = _kept_apart(base), _kept_apart(other)
    joint = Joint(
        f"{other.root.name}_mount",
        JointType.FIXED,
        mount.link,
        other.root.name,
        parent_pose=mount.pose @ (pose or Pose()),
    )
    return sort_links(
        replace(
            base,
            links=base.links + other.links,
            joints=(*base.joints, joint, *other.joints),
            frames=base.frames + other.frames,
            self_collisions=self_collisions,
            collision_exclusions=base.collision_exclusions + other.collision_exclusions,
            loops=base.loops + other.loops,
            drives=base.drives + other.drives,
            home=base.home + other.home,
            notes=tuple(dict.fromkeys(base.notes + other.notes)),
        )
    )


def _kept_apart(articulation: Articulation) -> Articulation:
    """Exclude every pair of links, where these do not collide with each other."""
    if articulation.self_collisions:
        return articulation
    # Exclusions say the same for this part alone, so that it can be joined to one whose links do collide.
    colliding = [link.name for link in articulation.links if link.collisions]
    return replace(articulation, collision_exclusions=tuple(combinations(colliding, 2)))


def subtree(articulation: Articulation, link: str, name: str | None = None) -> Articulation:
    """Return the link and everything beyond it as an articulation that has this link as its root.

    Raises:
        UnknownNameError: there is no such link.
        AssetError: a joint of the part mimics one outside it, or a loop closes through a link outside it.
    """
    if link not in articulation.link_names:
        raise UnknownNameError("link", link, articulation.link_names, f"'{articulation.name}'")
    articulation = sort_links(articulation)
    kept = {link}
    joints: list[Joint] = []
    for joint in articulation.joints:  # one pass is enough: parents come before children
        if joint.parent in kept:
            kept.add(joint.child)
            joints.append(joint)
    names = {joint.name for joint in joints}
    for joint in joints:
        if joint.mimic and joint.mimic.joint not in names:
            raise AssetError(
                f"'{articulation.name}': joint '{joint.name}' mimics '{joint.mimic.joint}', which is outside the "
                f"part beyond link '{link}': cut at a link nearer to the root, or drop the mimic"
            )
    for loop in articulation.loops:
        if len(kept.intersection((loop.first, loop.second))) == 1:
            raise AssetError(
                f"'{articulation.name}': loop '{loop.name}' closes through a link outside the part beyond link "
                f"'{link}': cut at a link nearer to the root, or drop the loop"
            )
    # Pairs with a link outside have no meaning in the part.
    exclusions = tuple(pair for pair in articulation.collision_exclusions if kept.issuperset(pair))
    return replace(
        articulation,
        name=name or link,
        links=tuple(body for body in articulation.links if body.name in kept),
        joints=tuple(joints),
        frames=tuple(frame for frame in articulation.frames if frame.link in kept),
        collision_exclusions=exclusions,
        loops=tuple(loop for loop in articulation.loops if kept.issuperset((loop.first, loop.second))),
        drives=tuple(drive for drive in articulation.drives if drive.joint in names),
        home=tuple((joint, position) for joint, position in articulation.home if joint in names),
    )


def branch(
    articulation: Articulation, joint: str, root: str, name: str | None = None, pose: Pose | None = None
) -> Articulation:
    """Return the joint and everything beyond it, on a massless link that becomes the root.

    Args:
        articulation: the description to cut.
        joint: the first joint that is kept.
        root: name of the new root link.
        name: of the result; that of the first link by default.
        pose: of the joint's frame at zero in the new root.

    Raises:
        UnknownNameError: there is no such joint.
        AssetError: as :func:`subtree`.
    """
    known = {each.name: each for each in articulation.joints}
    if joint not in known:
        raise UnknownNameError("joint", joint, tuple(known), f"'{articulation.name}'")
    limb = subtree(articulation, known[joint].child, name)
    first = replace(known[joint], parent=root, parent_pose=pose or Pose())
    return replace(limb, links=(Link(root), *limb.links), joints=(first, *limb.joints))


def without(articulation: Articulation, link: str) -> Articulation:
    """Return the articulation without the link and everything beyond it, such as an arm without its hand.

    Raises:
        UnknownNameError: there is no such link.
        AssetError: the link is the root, or a mimic or loop reaches from what is kept to what is not.
    """
    # The part's own checks also refuse mimics and loops across the cut.
    gone = set(subtree(articulation, link).link_names)
    if link == sort_links(articulation).root.name:
        raise AssetError(f"'{articulation.name}': link '{link}' is the root: nothing would be left without it")
    joints = tuple(joint for joint in articulation.joints if joint.child not in gone)
    kept = {joint.name for joint in joints}
    for follower in joints:
        if follower.mimic and follower.mimic.joint not in kept:
            raise AssetError(
                f"'{articulation.name}': joint '{follower.name}' mimics '{follower.mimic.joint}', which is beyond "
                f"link '{link}': cut elsewhere, or drop the mimic"
            )
    return replace(
        articulation,
        links=tuple(body for body in articulation.links if body.name not in gone),
        joints=joints,
        frames=tuple(frame for frame in articulation.frames if frame.link not in gone),
        collision_exclusions=tuple(pair for pair in articulation.collision_exclusions if gone.isdisjoint(pair)),
        loops=tuple(loop for loop in articulation.loops if gone.isdisjoint((loop.first, loop.second))),
    )


def edit_joints(articulation: Articulation, joints: tuple[str, ...], note: str, **changes: Any) -> Articulation:
    """Change fields of :class:`Joint` on every movable joint that a pattern matches in full.

    Args:
        articulation: the description.
        joints: regular expressions over joint names.
        note: the change and its reason, for the build report.
        changes: new values by field name.

    Raises:
        UnknownNameError: a pattern matches no movable joint.
    """
    names = articulation.joint_names
    chosen = {names[index] for index in match_names(joints, names, "joint", f"'{articulation.name}'")}
    edited = tuple(replace(joint, **changes) if joint.name in chosen else joint for joint in articulation.joints)
    return replace(articulation, joints=edited, notes=(*articulation.notes, note))


def edit_links(
    articulation: Articulation, links: tuple[str, ...], note: str, edit: Callable[[Link], Link]
) -> Articulation:
    """Apply ``edit`` to every link that a pattern matches in full.

    Args:
        articulation: the description.
        links: regular expressions over link names.
        note: the change and its reason, for the build report.
        edit: returns the changed link.

    Raises:
        UnknownNameError: a pattern matches no link.
    """
    names = articulation.link_names
    chosen = set(match_names(links, names, "link", f"'{articulation.name}'"))
    edited = tuple(edit(link) if index in chosen else link for index, link in enumerate(articulation.links))
    return replace(articulation, links=edited, notes=(*articulation.notes, note))


def simplify_collisions(articulation: Articulation, links: tuple[str, ...] = (".*",)) -> Articulation:
    """Replace the collision meshes of matching links by hulls of at most 38 vertices.

    Raises:
        UnknownNameError: a pattern matches no link.
    """

    def simplified(shape: Shape) -> Shape:
        mesh = shape.geometry
        return replace(shape, geometry=simplified_hull(mesh)) if isinstance(mesh, Mesh) else shape

    def edit(link: Link) -> Link:
        return replace(link, collisions=tuple(simplified(shape) for shape in link.collisions))

    note = "collision meshes are replaced by hulls of at most 38 of their vertices, for speed"
    return edit_links(articulation, links, note, edit)


def inertia_of_shapes(articulation: Articulation, links: tuple[str, ...]) -> Articulation:
    """Compute the inertia of matching links from their collision shapes; their masses stay.

    For models that have placeholders; the shapes count as solids of one density.

    Raises:
        UnknownNameError: a pattern matches no link.
        AssetError: a link has no collision shape, or no mass.
    """

    def edit(link: Link) -> Link:
        # The mass is proportional to the density: one computation at density 1 gives the density of the right mass.
        solid = shapes_mass_properties(link.collisions, 1.0)
        solid = shapes_mass_properties(link.collisions, link.mass / solid.mass)
        return replace(link, center_of_mass=solid.center_of_mass, inertia=solid.inertia)

    note = f"inertias of {', '.join(links)} are those of their collision shapes: the model has placeholders"
    return edit_links(articulation, links, note, edit)


def add_frames(articulation: Articulation, *frames: Frame) -> Articulation:
    """Add frames; each may be given on a link or on another frame.

    Raises:
        UnknownNameError: a frame is on nothing that exists.
    """
    for frame in frames:
        host = _frame(articulation, frame.link)
        # Frames are stored on links, so that a chain of them needs no order.
        placed = Frame(frame.name, host.link, host.pose @ frame.pose)
        articulation = replace(articulation, frames=(*articulation.frames, placed))
    check_structure(articulation)
    return articulation


def _frame(articulation: Articulation, name: str) -> Frame:
    try:
        return articulation.frame(name)
    except KeyError:
        known = (*articulation.link_names, *(frame.name for frame in articulation.frames))
        raise UnknownNameError("link or frame", name, known, f"'{articulation.name}'") from None


def renamed(articulation: Articulation, rename: Callable[[str], str]) -> Articulation:
    """Rename links, joints, loops and frames by ``rename``.

    Raises:
        AssetError: two things of a kind would have one name.
    """

    def of_joint(joint: Joint) -> Joint:
        mimic = joint.mimic and replace(joint.mimic, joint=rename(joint.mimic.joint))
        names = {"name": rename(joint.name), "parent": rename(joint.parent), "child": rename(joint.child)}
        return replace(joint, mimic=mimic, **names)

    def of_loop(loop: LoopJoint) -> LoopJoint:
        return replace(loop, name=rename(loop.name), first=rename(loop.first), second=rename(loop.second))

    changed = replace(
        articulation,
        links=tuple(replace(link, name=rename(link.name)) for link in articulation.links),
        joints=tuple(of_joint(joint) for joint in articulation.joints),
        frames=tuple(Frame(rename(frame.name), rename(frame.link), frame.pose) for frame in articulation.frames),
        collision_exclusions=tuple((rename(a), rename(b)) for a, b in articulation.collision_exclusions),
        loops=tuple(of_loop(loop) for loop in articulation.loops),
        drives=tuple(replace(drive, joint=rename(drive.joint)) for drive in articulation.drives),
        home=tuple((rename(joint), position) for joint, position in articulation.home),
    )
    check_structure(changed)  # two names may have become one
    return changed


def sort_links(articulation: Articulation) -> Articulation:
    """Return the same tree with links in depth-first order and joints in the order of their child links.

    Raises:
        AssetError: the links form no single tree.
    """
    check_structure(articulation)
    children: dict[str, list[str]] = {}
    joint_of = {joint.child: joint for joint in articulation.joints}
    for link in articulation.links:
        if link.name in joint_of:
            children.setdefault(joint_of[link.name].parent, []).append(link.name)
    # check_structure has made sure that there is exactly one.
    (root,) = (link.name for link in articulation.links if link.name not in joint_of)
    order: list[str] = []
    stack = [root]
    while stack:
        name = stack.pop()
        order.append(name)
        stack += reversed(children.get(name, []))
    by_name = {link.name: link for link in articulation.links}
    links = tuple(by_name[name] for name in order)
    return replace(articulation, links=links, joints=tuple(joint_of[name] for name in order[1:]))
