"""The capabilities of MuJoCo, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate, unsupported
from orbit_mjmodel.capabilities import shared_support

CAPABILITIES = Capabilities(
    shared_support("MuJoCo")
    | {
        Capability.COPIED_STATES: EXACT,
        Capability.DETERMINISTIC: EXACT,
        Capability.SHADOWS: approximate(
            "from a map of 6 mm squares that reaches 3 m around the middle of what moves; beyond, all is lit"
        ),
        Capability.RAY_TRACED_RGB: unsupported("MuJoCo rasterises"),
        Capability.CLOTH: approximate(
            "a flex of the scene's stiffnesses, whose particles and triangles meet solids; friction is a soft "
            "constraint; joint wrenches do not feel what touches it, and its integrator is 'discrete'"
        ),
        Capability.ROPES: approximate(
            "a chain of stiff capsules on ball joints, which does not stretch, and resists twist as it resists bending"
        ),
        Capability.GPU: unsupported("this backend simulates on the CPU"),
    }
)
