"""The capabilities of MuJoCo-Warp, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate, unsupported
from orbit_mjmodel.capabilities import shared_support

CAPABILITIES = Capabilities(
    shared_support("MuJoCo-Warp")
    | {
        Capability.SIGNED_DISTANCE_FIELDS: approximate(
            "as MuJoCo's, in single precision: contacts are found by descent from 40 points, none left out where they "
            "meet; the lead of a screw of 4 mm came to 4.16 mm, on a CPU; convex meshes of other bodies pass through"
        ),
        Capability.HEIGHT_FIELDS: approximate(
            "balls meet the surface itself; other shapes meet it prism by prism, whose sides are felt: on a level "
            "floor of cells of 0.1 m a box stops after 0.55 to 0.95 of its way; exact where the whole field has no "
            "more than eight planes"
        ),
        Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
        Capability.DETERMINISTIC: approximate(
            "bit for bit on a CPU; on a GPU only with WarpConfig(deterministic=True), for sums run in any order"
        ),
        Capability.SHADOWS: EXACT,
        Capability.RAY_TRACED_RGB: approximate("direct light and its shadows: no reflections, no light from surfaces"),
        Capability.GPU: EXACT,
        Capability.CLOTH: unsupported(
            "MuJoCo-Warp's kernels of flexes had not compiled after 240 s on an H200, and are not connected to this "
            "backend"
        ),
        Capability.ROPES: unsupported(
            "chains of capsules, which could stand for ropes, are not connected to this backend"
        ),
    }
)
