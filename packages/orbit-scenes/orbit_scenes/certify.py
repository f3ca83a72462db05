"""Premises of a scene: nothing overlaps, and everything stays where it is when physics runs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orbit_assets.decomposition import Convex, convex_shape, distance
from orbit_core.interfaces.errors import PremiseError
from orbit_core.interfaces.layout import home_positions
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Entity, ObjectSpec, Plane, Pose, Scene
from orbit_core.scene.pose import FloatArray
from orbit_scenes.separate import separated

# Metres by which shapes may enter each other: what is written and read in single precision touches so.
_TOUCH = 0.001
# Metres and radians by which a thing may move while it settles, and joint positions in rad or m.
_MOVED, _TURNED, _OPENED = 0.02, 0.2, 0.03
# Seconds between looks at a scene that settles, and m/s below which a thing is still; rad/s are five times that.
_CHUNK, _STILL = 0.5, 0.005
# Metres of fall from which a thing counts as fallen.
_FELL = 0.25


@dataclass(frozen=True)
class Movement:
    """Motion of one object while a scene settles."""

    name: str
    """Name of the object in the scene."""
    distance: float
    """m"""
    angle: float
    """rad"""
    fall: float
    """Metres that it sank."""
    joints: float = 0.0
    """Largest change of a joint's position, rad or m."""

    @property
    def stayed(self) -> bool:
        """True if it neither moved nor turned nor opened noticeably."""
        return self.distance <= _MOVED and self.angle <= _TURNED and self.joints <= _OPENED


@dataclass(frozen=True)
class Certificate:
    """Results of a scene's checks."""

    overlaps: tuple[tuple[str, str], ...]
    """Pairs of objects whose shapes enter each other by more than 1 mm at the start."""
    movements: tuple[Movement, ...]
    """Motion of every object over the time that was simulated; none where only the geometry was checked."""
    seconds: float
    """Simulated time."""

    @property
    def moved(self) -> tuple[Movement, ...]:
        """Objects that did not stay."""
        return tuple(each for each in self.movements if not each.stayed)

    @property
    def holds(self) -> bool:
        """True if nothing overlaps and everything stays."""
        return not self.overlaps and not self.moved

    def check(self) -> None:
        """Reject a scene whose premises do not hold.

        Raises:
            PremiseError: names the first objects that overlap, fall or move.
        """
        if self.overlaps:
            first, second = self.overlaps[0]
            raise PremiseError(f"'{first}' and '{second}' overlap{_more(len(self.overlaps))}: move one of them")
        if not self.moved:
            return
        worst = max(self.moved, key=lambda each: (each.fall > _FELL, each.distance, each.joints))
        more = _more(len(self.moved))
        if worst.fall > _FELL:
            raise PremiseError(
                f"'{worst.name}' falls {worst.fall:.2f} m within {self.seconds:g} s{more}: put it on something"
            )
        raise PremiseError(
            f"'{worst.name}' does not stay: within {self.seconds:g} s it moves {worst.distance:.3f} m, turns by "
            f"{worst.angle:.2f} rad and moves its joints by {worst.joints:.3f}{more}: set it down level, or settle it"
        )


def _more(count: int) -> str:
    return f" (and {count - 1} more)" if count > 1 else ""


def certify(scene: Scene, backend: str | None = None, seconds: float = 1.0) -> Certificate:
    """Check that nothing in a scene overlaps, and with a backend that everything stays for a time.

    Args:
        scene: to be checked; its robots are held by their drives.
        backend: name of an installed backend that simulates it; None checks the geometry only.
        seconds: simulated time.
    """
    # Geometry first: it costs no engine, and explains most of what physics would push apart.
    pairs = tuple(overlaps(scene))
    if backend is None:
        return Certificate(pairs, (), 0.0)
    return Certificate(pairs, _simulated(scene, backend, seconds)[1], seconds)


def settled(scene: Scene, backend: str, seconds: float = 10.0) -> Scene:
    """Simulate a scene until it rests, and return it with free objects where they then are.

    Contact leaves objects pressed into each other by up to a millimetre; they are moved out of one another.

    Args:
        scene: as it starts.
        backend: name of an installed backend that simulates it.
        seconds: most simulated time; it ends earlier once everything is still.

    Raises:
        PremiseError: an object leaves the scene: it falls through the ground or for more than a few metres.
    """
    poses, movements = _simulated(scene, backend, seconds, until_still=True)
    for each in movements:
        if each.distance > 5.0 or poses[each.name].position[2] < -0.5:
            raise PremiseError(f"'{each.name}' leaves the scene while it settles: it goes {each.distance:.1f} m")
    objects = tuple(replace(each, pose=poses[each.name]) if each.is_free_body else each for each in scene.objects)
    return separated(replace(scene, objects=objects))


def _simulated(
    scene: Scene, backend: str, seconds: float, until_still: bool = False
) -> tuple[dict[str, Pose], tuple[Movement, ...]]:
    """Simulate a scene; return the last pose of every object and its motion."""
    from orbit_core.world import simulate

    # Cameras and other sensors cost time and change nothing.
    world = simulate(replace(scene, sensors=(), markers=()), 1, backend)
    try:
        objects = world.objects
        before = {
            name: (thing.root_pose[0].clone(), thing.joint_positions[0].clone()) for name, thing in objects.items()
        }
        steps = max(1, round(seconds / scene.physics_dt))
        chunk = max(1, round(_CHUNK / scene.physics_dt)) if until_still else steps
        for done in range(0, steps, chunk):
            world.step(min(chunk, steps - done))
            speeds = [thing.root_velocity[0].abs() for thing in objects.values()]
            if until_still and all(float(v[:3].max()) < _STILL and float(v[3:].max()) < 5.0 * _STILL for v in speeds):
                break
        poses, found = {}, []
        for name, thing in objects.items():
            start, joints = before[name]
            values = thing.root_pose[0].tolist()
            x, y, z, qw, qx, qy, qz = values
            poses[name] = Pose((x, y, z), (qw, qx, qy, qz))
            # The rotation from the start to the end about any axis.
            turned = (Pose(orientation=tuple(start[3:].tolist())).inverse() @ poses[name]).orientation
            angle = 2.0 * math.acos(min(1.0, abs(turned[0])))
            change = (thing.joint_positions[0] - joints).abs()
            moved = float((thing.root_pose[0, :3] - start[:3]).norm())
            fall = float(start[2]) - z
            found.append(Movement(name, moved, angle, fall, float(change.max()) if len(change) else 0.0))
        return poses, tuple(found)
    finally:
        world.close()


def overlaps(scene: Scene, depth: float = _TOUCH) -> Iterator[tuple[str, str]]:
    """Yield pairs of entities whose collision shapes enter each other by more than ``depth`` m at home.

    A mesh counts as its convex hull. Terrain counts where it is a level plane.
    """
    names, shapes, free = [], [], []
    for entity in scene.entities:
        for shape in _shapes(entity, depth):
            names.append(entity.name)
            shapes.append(shape)
            free.append(not entity.fixed_base)
    for plane in scene.terrain:
        # Only what moves can sink in: walls may begin below the ground.
        if isinstance(plane.geometry, Plane) and abs(plane.pose.rotation_matrix()[2, 2] - 1.0) < 1e-9:
            height = plane.pose.position[2]
            for name, shape, moves in zip(names, shapes, free, strict=True):
                if moves and shape.bounds()[0][2] < height - depth:
                    yield name, plane.name or "terrain"
                    break
    if not shapes:
        return
    # Boxes along the axes first: of 600 shapes of a house a few hundred pairs are left for the exact test.
    low, high = (np.stack([shape.bounds()[side] for shape in shapes]) for side in (0, 1))
    seen: set[tuple[str, str]] = set()
    for index, name in enumerate(names):
        near = ((low[index] < high[index + 1 :]) & (low[index + 1 :] < high[index])).all(1)
        for other in np.flatnonzero(near) + index + 1:
            pair = (name, names[other])
            if name != names[other] and pair not in seen and distance(shapes[index], shapes[other]) <= 0.0:
                seen.add(pair)
                yield pair


def _shapes(entity: Entity, depth: float) -> Iterator[Convex]:
    """Yield the convex shapes of an entity in the environment's frame, each smaller by half of ``depth`` all around."""
    articulation = entity.articulation
    positions = home_positions(entity)
    poses = link_poses(articulation, dict(zip(articulation.joint_names, positions, strict=True)))
    for link in articulation.links:
        for shape in link.collisions:
            convex = convex_shape(shape, entity.pose @ poses[link.name])
            if convex is not None:
                yield _shrunk(convex, depth / 2)


def _shrunk(shape: Convex, by: float) -> Convex:
    """Return a convex shape drawn in towards its middle, so that its sides are ``by`` m further in or more."""
    if shape.radius > by:
        return replace(shape, radius=shape.radius - by)
    middle: FloatArray = shape.points.mean(0)
    arms = shape.points - middle
    disc = max(shape.disc - by, 0.0)
    # The least extent decides: its side is the nearest to the middle.
    spread = np.linalg.svd(arms - arms.mean(0), full_matrices=False)[2]
    spans = np.ptp(arms @ spread.T, axis=0)
    spans = spans[spans > 1e-9]
    half = float(spans.min()) / 2 if len(spans) else 0.0
    share = max(0.0, 1.0 - by / half) if half > 0.0 else 1.0
    return Convex(middle + share * arms, shape.radius, disc, shape.axis)


def free_objects(scene: Scene) -> tuple[ObjectSpec, ...]:
    """Return the objects that can be carried away: one rigid body that nothing holds."""
    return tuple(each for each in scene.objects if each.is_free_body)
