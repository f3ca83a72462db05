"""The capabilities of Newton's solvers, and the reasons for what they lack."""

from __future__ import annotations

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate, unsupported

_NO_IMAGES = "Newton's ray tracer is not connected to this backend: choose another renderer"
_NO_RAYS = "Newton's ray casts are not connected to this backend"
_MATTER = {
    Capability.CLOTH: unsupported(
        "Newton's cloth is VBD's, which is not connected: with 10 sweeps per 2 ms it pressed on two fingers with 4 "
        "times its weight"
    ),
    Capability.ROPES: unsupported("Newton's rods are not connected to this backend, and not measured"),
    Capability.SOFT_BODIES: unsupported(
        "Newton's VBD is not connected: with its examples' 10 sweeps per 1.7 ms a beam droops 5 times as much as it "
        "should and a block presses with 2.1 times its weight; with 20 per 0.5 ms that is 4 % off, for 79 ms of a core "
        "per 5 ms; a beam of tetrahedra, 2, 4 and 8 cells across, droops 32, 11 and 3 % too little when solved exactly"
    ),
    Capability.FLUIDS: unsupported(
        "Newton's implicit MPM is not connected: after 2 s at rest water has lost 20 to 58 % of its volume (2 cm "
        "voxels), and 1.1 % of a cup leaked through walls of 6 mm (1 cm), though a dam breaks within 10 %"
    ),
}
_ROUNDED = "rounding in single precision adds up over the solver's steps in each physics step: 3e-5 of a force"
_FOUND = (
    "contacts are found once in a physics step and stay in place within it: rolling balls gain or lose by per cents"
)
_SHARES = "each sweep applies its share of a drive, and the shares do not add up to the whole: responses are 1 % off"
_ORDER = "bit for bit on a CPU; on a GPU contacts are found in any order, and sums run in any"

_COMMON = {
    Capability.ARTICULATIONS: EXACT,
    Capability.FLOATING_BASE: EXACT,
    Capability.VELOCITY_LIMITS: unsupported("the solver does not limit the velocity of a joint"),
    Capability.SELF_COLLISIONS: EXACT,
    Capability.GRAVITY_COMPENSATION: EXACT,
    Capability.STATIC_FRICTION: approximate("one coefficient of sliding friction, the dynamic one"),
    Capability.CONVEX_MESHES: EXACT,
    Capability.TRIANGLE_MESHES: EXACT,
    Capability.SIGNED_DISTANCE_FIELDS: unsupported("Newton builds distance fields of meshes on a GPU only"),
    Capability.DYNAMIC_TRIANGLE_MESHES: unsupported("Newton collides two moving surfaces on a GPU only"),
    Capability.HEIGHT_FIELDS: EXACT,
    Capability.EXTERNAL_WRENCHES: EXACT,
    Capability.RAY_CASTS: unsupported(_NO_RAYS),
    Capability.RANDOMIZE_FRICTION: EXACT,
    Capability.RANDOMIZE_GAINS: EXACT,
    Capability.RANDOMIZE_JOINTS: unsupported("joint parameters per environment are not connected to this backend"),
    Capability.RANDOMIZE_LIMITS: unsupported("joint limits per environment are not connected to this backend"),
    Capability.SNAPSHOTS: EXACT,
    Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
    Capability.DETERMINISTIC: approximate(_ORDER),
    Capability.RGB: unsupported(_NO_IMAGES),
    Capability.COLORS_PER_ENVIRONMENT: unsupported(_NO_IMAGES),
    Capability.LIGHTING: unsupported(_NO_IMAGES),
    Capability.LIGHTS_PER_ENVIRONMENT: unsupported(_NO_IMAGES),
    Capability.TEXTURES: unsupported(_NO_IMAGES),
    Capability.SHADOWS: unsupported(_NO_IMAGES),
    Capability.DEPTH: unsupported(_NO_IMAGES),
    Capability.NORMALS: unsupported(_NO_IMAGES),
    Capability.SEGMENTATION: unsupported(_NO_IMAGES),
    Capability.RAY_TRACED_RGB: unsupported(_NO_IMAGES),
    Capability.ALBEDO: unsupported(_NO_IMAGES),
    Capability.JOINT_SPRINGS: unsupported("joints' own springs are not connected to this backend"),
    Capability.POLYNOMIAL_MIMICS: unsupported("only linear laws of mimic joints are connected to this backend"),
    Capability.MASSLESS_LINKS: unsupported("links without mass were never tried with this backend"),
    Capability.WELD_LOOPS: unsupported("joints that close loops are not connected to this backend"),
    Capability.LOOP_JOINTS: unsupported("joints that close loops are not connected to this backend"),
    Capability.LOOP_WRENCHES: unsupported("joints that close loops are not connected to this backend"),
    Capability.SHAPES_PER_ENVIRONMENT: unsupported("all environments have the same shapes on this backend"),
    Capability.GPU: approximate("each step waits for the device to say that it went well; not measured on one yet"),
    **_MATTER,
}

FEATHERSTONE = Capabilities(
    _COMMON
    | {
        Capability.IMPLICIT_DRIVES: EXACT,
        Capability.EFFORT_LIMITS: approximate(_ROUNDED),
        Capability.JOINT_DAMPING: EXACT,
        Capability.JOINT_FRICTION: approximate(
            "friction is viscous below 0.005 rad/s (m/s): a held joint creeps so fast"
        ),
        Capability.ARMATURE: approximate(_ROUNDED),
        Capability.MIMIC_JOINTS: EXACT,
        Capability.FRICTION: approximate(
            "friction grows with the speed of slip: a held contact creeps, by up to 2 cm/s near the limit"
        ),
        Capability.TORSIONAL_FRICTION: EXACT,
        Capability.ROLLING_FRICTION: approximate(_FOUND),
        Capability.RESTITUTION: approximate("contacts are spring-dampers tuned to the rebound"),
        Capability.COMPLIANT_CONTACT: approximate(
            "the stiffness is shared evenly by the contacts of a body, and no larger than the step resolves"
        ),
        Capability.CONTACT_FORCES: approximate(
            "friction grows with the speed of slip, so that the forces on what is held are half a per cent off"
        ),
        Capability.FRICTION_FORCES: approximate("friction grows with the speed of slip"),
        Capability.JOINT_WRENCHES: approximate("of statics: what accelerates the links is left out"),
        Capability.RANDOMIZE_MASS: approximate(_ROUNDED),
        Capability.RANDOMIZE_CENTER_OF_MASS: EXACT,
        Capability.RANDOMIZE_GRAVITY: approximate(_ROUNDED),
    }
)

XPBD = Capabilities(
    _COMMON
    | {
        Capability.IMPLICIT_DRIVES: approximate(_SHARES),
        Capability.EFFORT_LIMITS: approximate("judged where a physics step begins"),
        Capability.JOINT_DAMPING: EXACT,
        Capability.JOINT_FRICTION: approximate(
            "friction is viscous below 0.005 rad/s (m/s): a held joint creeps so fast"
        ),
        Capability.ARMATURE: approximate(
            "inertia of the driven link, about every axis and against the world; none of sliding joints"
        ),
        Capability.MIMIC_JOINTS: EXACT,
        Capability.FRICTION: approximate(
            f"{_FOUND}; sweeps pass on too little of light fingers' force to hold a heavy box"
        ),
        Capability.TORSIONAL_FRICTION: EXACT,
        Capability.ROLLING_FRICTION: EXACT,
        Capability.RESTITUTION: approximate("velocities are differences of positions in single precision: 5e-6 off"),
        Capability.COMPLIANT_CONTACT: unsupported("XPBD's contacts are rigid"),
        Capability.CONTACT_FORCES: approximate(
            "what the sweeps applied: up to a quarter off between things that lie on each other, and without rebounds"
        ),
        Capability.FRICTION_FORCES: approximate("of the last sweep, as contact forces are"),
        Capability.JOINT_WRENCHES: unsupported(
            "what the sweeps applied is 0.7 % off a hanging link's weight at steps of 5 ms"
        ),
        Capability.RANDOMIZE_MASS: EXACT,
        Capability.RANDOMIZE_CENTER_OF_MASS: approximate(_SHARES),
        Capability.RANDOMIZE_GRAVITY: EXACT,
    }
)
