"""The capabilities that engines which step MuJoCo's model share, and the reasons for what they lack."""

from __future__ import annotations

from orbit_core.interfaces import EXACT, MATTER, Capability, Support, approximate, unsupported


def shared_support(engine: str) -> dict[Capability, Support]:
    """Support by capability, of physics and pictures; ``engine`` names itself in the reasons."""
    return {
        Capability.ARTICULATIONS: EXACT,
        Capability.FLOATING_BASE: EXACT,
        Capability.IMPLICIT_DRIVES: approximate(
            "a weakly damped drive above one radian of natural frequency per physics step is damped further, to be "
            "stable; the build report names its joint"
        ),
        Capability.EFFORT_LIMITS: approximate(
            "a drive is held to its limit by the effort that a step begins with, and a drive at its limit is applied "
            "without its damping: it swings about its target where its damping over a step exceeds twice the inertia, "
            "and a load that comes within a step meets a drive without limit for that step"
        ),
        Capability.VELOCITY_LIMITS: unsupported(f"{engine} does not limit the velocity of a joint"),
        Capability.JOINT_DAMPING: EXACT,
        Capability.JOINT_SPRINGS: approximate(
            "exact below one radian of natural frequency per physics step; a stiffer, weakly damped spring is damped "
            "further, to be stable; the build report names its joint"
        ),
        Capability.JOINT_FRICTION: approximate("friction is a soft constraint: a held joint creeps slowly under load"),
        Capability.ARMATURE: EXACT,
        Capability.MIMIC_JOINTS: approximate(
            "the coupling is a stiff soft constraint: it gives way slightly under load"
        ),
        Capability.POLYNOMIAL_MIMICS: approximate(
            "the coupling is a stiff soft constraint: it gives way slightly under load"
        ),
        Capability.MASSLESS_LINKS: EXACT,
        Capability.WELD_LOOPS: approximate("the weld is a stiff soft constraint: it gives way slightly under load"),
        Capability.LOOP_JOINTS: approximate(
            "the ball joint is a stiff soft constraint: it gives way slightly under load"
        ),
        Capability.SELF_COLLISIONS: EXACT,
        Capability.GRAVITY_COMPENSATION: EXACT,
        Capability.FRICTION: approximate("friction is a soft constraint: a held contact creeps slowly under load"),
        Capability.STATIC_FRICTION: approximate("one coefficient of sliding friction, the dynamic one"),
        Capability.TORSIONAL_FRICTION: approximate(
            "friction is a soft constraint: what a grip should hold turns, seven times slower with impratio=10"
        ),
        Capability.ROLLING_FRICTION: approximate(
            "acts on round shapes of single bodies, and on any shape that asks for more than the default coefficient"
        ),
        Capability.RESTITUTION: approximate(
            "a rebound within a step, along the normal alone; what slides on through the impact rebounds faster, by up "
            "to the coefficient of friction times its slip: a flat box with friction 0.15 by 0.16 of its speed. Shapes "
            "that differ between environments, cloth, the integrators 'rk4' and 'discrete' and pyramidal cones have a "
            "spring of eight steps instead, which leaves little of friction where it is lively"
        ),
        Capability.COMPLIANT_CONTACT: approximate(
            "stiffness scales with the effective mass: as asked where a single body meets an immovable one"
        ),
        Capability.CONVEX_MESHES: EXACT,
        Capability.TRIANGLE_MESHES: approximate(
            "each flat face is a solid that reaches 10 mm inward, so thinner walls become as thick; balls lose speed "
            "at edges between faces: 0.18 of the amplitude in a period, in a bowl of facets of 50 mm"
        ),
        Capability.DYNAMIC_TRIANGLE_MESHES: unsupported(
            f"{engine} collides the convex hull of a moving mesh: split the mesh into convex pieces"
        ),
        Capability.SIGNED_DISTANCE_FIELDS: unsupported(f"{engine}'s distance fields are not connected to this backend"),
        Capability.HEIGHT_FIELDS: EXACT,
        Capability.CONTACT_FORCES: EXACT,
        Capability.FRICTION_FORCES: EXACT,
        Capability.JOINT_WRENCHES: EXACT,
        Capability.LOOP_WRENCHES: EXACT,
        Capability.EXTERNAL_WRENCHES: EXACT,
        Capability.RAY_CASTS: EXACT,
        Capability.RANDOMIZE_MASS: EXACT,
        Capability.RANDOMIZE_CENTER_OF_MASS: EXACT,
        Capability.RANDOMIZE_FRICTION: EXACT,
        Capability.RANDOMIZE_GAINS: EXACT,
        Capability.RANDOMIZE_JOINTS: EXACT,
        Capability.RANDOMIZE_LIMITS: EXACT,
        Capability.RANDOMIZE_GRAVITY: EXACT,
        Capability.SHAPES_PER_ENVIRONMENT: EXACT,
        Capability.SNAPSHOTS: EXACT,
        Capability.RGB: EXACT,
        Capability.COLORS_PER_ENVIRONMENT: EXACT,
        Capability.LIGHTING: EXACT,
        Capability.LIGHTS_PER_ENVIRONMENT: EXACT,
        Capability.DEPTH: EXACT,
        Capability.NORMALS: EXACT,
        Capability.ALBEDO: EXACT,
        Capability.SEGMENTATION: EXACT,
        **dict.fromkeys(MATTER, unsupported(f"{engine}'s deformables are not connected to this backend")),
    }
