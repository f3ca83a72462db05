"""The capabilities of SAPIEN, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, MATTER, Capabilities, Capability, approximate, unsupported

_SHADOW_MAP = "from a map of 6 mm squares that reaches 3 m around the middle of what moves; beyond, all is lit"
_LINEAR = "reckons in linear light: right within 4 of 255 where no directional light falls, elsewhere 8 to 33 brighter"

_IMAGES = {
    Capability.RGB: EXACT,
    Capability.COLORS_PER_ENVIRONMENT: EXACT,
    Capability.LIGHTING: EXACT,
    Capability.SHADOWS: approximate(_SHADOW_MAP),
    Capability.DEPTH: EXACT,
    Capability.NORMALS: EXACT,
    Capability.ALBEDO: EXACT,
    Capability.SEGMENTATION: EXACT,
    Capability.RAY_TRACED_RGB: unsupported("this tier rasterises: choose renderer 'sapien-rt'"),
}

FAST_IMAGES = Capabilities(_IMAGES)
"""Capabilities of the plain rasteriser alone."""
PBR_IMAGES = Capabilities(
    _IMAGES
    | {
        Capability.LIGHTING: approximate(f"{_LINEAR}, with highlights"),
        Capability.SHADOWS: approximate(f"{_SHADOW_MAP}; edges are blurred over 5 squares"),
    }
)
"""Capabilities of the rasteriser with physically based materials."""
TRACED_IMAGES = Capabilities(
    _IMAGES
    | {
        Capability.LIGHTING: approximate(
            f"{_LINEAR}, with highlights, light from other surfaces and none of the ambient light where they hide the "
            "sky, which is of the ambient light's colour"
        ),
        Capability.SHADOWS: approximate("what surfaces throw back falls into them"),
        Capability.RAY_TRACED_RGB: EXACT,
    }
)
"""Capabilities of the path tracer alone."""

CAPABILITIES = Capabilities(
    {
        Capability.ARTICULATIONS: EXACT,
        Capability.FLOATING_BASE: EXACT,
        Capability.IMPLICIT_DRIVES: approximate(
            "PhysX's iterations end short of a stiff drive's balance, the more so the larger its damping and the step: "
            "a level chain of two 1 kg links sags by 1.42 mrad where its stiffness of 10,000 N m/rad says 1.00, with "
            "damping 500 N m s/rad and steps of 5 ms (by 1.20 with position_iterations=48)"
        ),
        Capability.EFFORT_LIMITS: approximate(
            "the drive's limit bounds the joint's own damping along with the drive's effort"
        ),
        Capability.VELOCITY_LIMITS: EXACT,
        Capability.JOINT_DAMPING: EXACT,
        Capability.JOINT_SPRINGS: approximate(
            "exact where no drive acts on the joint; beside one, whose iterations end short of its balance with the "
            "spring, the joint strays by some 1e-4 m for a moment; a spring of more than one radian of natural "
            "frequency per step beside a drive or friction is refused"
        ),
        Capability.JOINT_FRICTION: approximate(
            "exact where no drive acts on the joint; elsewhere a damper that saturates, so that a held joint creeps"
        ),
        Capability.ARMATURE: EXACT,
        Capability.MIMIC_JOINTS: approximate(
            "the coupling is a stiff spring: it gives way slightly under load, and loads joints between leader and "
            "follower that are not parallel to them"
        ),
        Capability.POLYNOMIAL_MIMICS: unsupported("PhysX's fixed tendons weigh joint positions linearly"),
        Capability.MASSLESS_LINKS: EXACT,
        Capability.WELD_LOOPS: unsupported("welds that close loops are not connected to this backend"),
        Capability.LOOP_JOINTS: EXACT,
        Capability.SELF_COLLISIONS: EXACT,
        Capability.GRAVITY_COMPENSATION: EXACT,
        Capability.FRICTION: approximate(
            "PhysX averages a pair's coefficients; each shape is given those whose averages come nearest to the larger "
            "ones, exactly unless the build report says otherwise; an impact that stops from slipping has 0.83 to 1.04 "
            "of its friction, and less with a contact_offset above 1 mm, none beyond 4 mm between the two"
        ),
        Capability.STATIC_FRICTION: approximate(
            "PhysX's TGS solver lets faces slip below static friction; its PGS, temporal_gauss_seidel=False, holds them"
        ),
        Capability.TORSIONAL_FRICTION: approximate(
            "the torque is the coefficient times the normal force where bodies touch at one point; where they touch at "
            "more, friction at those points alone resists the spin. PhysX's PGS, temporal_gauss_seidel=False, has none"
        ),
        Capability.ROLLING_FRICTION: unsupported("PhysX has no rolling friction"),
        Capability.RESTITUTION: approximate(
            "a pair's coefficients are averaged, as friction's are, and slow impacts do not rebound"
        ),
        Capability.COMPLIANT_CONTACT: unsupported("SAPIEN does not pass on the damping of PhysX's compliant contacts"),
        Capability.CONVEX_MESHES: approximate("hulls of many vertices are simplified by PhysX's cooking"),
        Capability.TRIANGLE_MESHES: EXACT,
        Capability.SIGNED_DISTANCE_FIELDS: unsupported(
            "SAPIEN's binding of PhysX cooks convex and triangle meshes, and no distance fields"
        ),
        Capability.DYNAMIC_TRIANGLE_MESHES: unsupported(
            "PhysX moves triangle meshes on the GPU only: split the mesh into convex pieces"
        ),
        Capability.HEIGHT_FIELDS: EXACT,
        Capability.CONTACT_FORCES: approximate("normal forces alone: PhysX does not tell those of friction"),
        Capability.JOINT_WRENCHES: approximate(
            "PhysX's joint force is of the beginning of a step, in axes that have turned by omega dt at its end"
        ),
        Capability.LOOP_WRENCHES: unsupported(
            "PhysX's joint forces leave out those of joints that close loops, which SAPIEN does not report either"
        ),
        Capability.EXTERNAL_WRENCHES: EXACT,
        Capability.RAY_CASTS: approximate("PhysX has no cylinders: SAPIEN's are prisms of 32 sides"),
        Capability.RANDOMIZE_MASS: EXACT,
        Capability.RANDOMIZE_CENTER_OF_MASS: EXACT,
        Capability.RANDOMIZE_FRICTION: approximate("averages of a pair's coefficients, as for friction"),
        Capability.RANDOMIZE_GAINS: EXACT,
        Capability.RANDOMIZE_JOINTS: EXACT,
        Capability.RANDOMIZE_LIMITS: EXACT,
        Capability.RANDOMIZE_GRAVITY: EXACT,
        Capability.SHAPES_PER_ENVIRONMENT: unsupported("this backend builds every environment alike"),
        Capability.SNAPSHOTS: approximate(
            "loading drops what PhysX remembers of contacts: all loads of a state go on alike bit for bit, and part "
            "from the run that was saved by some 1e-6 m where bodies touch, and by what chaos makes of it"
        ),
        Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
        Capability.DETERMINISTIC: approximate(
            "a run repeats bit for bit with the same number of environments; with another, PhysX's TGS solver sums "
            "contacts in another order, and they differ in the last bit"
        ),
        **(_IMAGES | {Capability.RAY_TRACED_RGB: EXACT}),
        Capability.GPU: unsupported(
            "untested: PhysX's GPU library is no part of SAPIEN's package and was never at hand; where it is installed "
            "(python -m orbit_sapien.physx_gpu), device 'cuda' runs code that no GPU has run"
        ),
        **dict.fromkeys(MATTER, unsupported("SAPIEN has no deformable bodies")),
    }
)
