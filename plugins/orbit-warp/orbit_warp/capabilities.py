"""The capabilities of MuJoCo-Warp, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate
from orbit_mjmodel.capabilities import shared_support

CAPABILITIES = Capabilities(
    shared_support("MuJoCo-Warp")
    | {
        Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
        Capability.DETERMINISTIC: approximate(
            "bit for bit on a CPU; on a GPU only with WarpConfig(deterministic=True), for sums run in any order"
        ),
        Capability.SHADOWS: EXACT,
        Capability.RAY_TRACED_RGB: approximate("direct light and its shadows: no reflections, no light from surfaces"),
        Capability.GPU: EXACT,
    }
)
