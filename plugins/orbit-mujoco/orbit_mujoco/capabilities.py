"""The capabilities of MuJoCo, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate, unsupported
from orbit_mjmodel.capabilities import shared_support

CAPABILITIES = Capabilities(
    shared_support("MuJoCo")
    | {
        Capability.SIGNED_DISTANCE_FIELDS: approximate(
            "distances are interpolated in an octree whose finest cells are 2^-7 of the mesh's box, and contacts are "
            "found by descent from 40 points, other ones from step to step: what rests on them creeps and trembles"
        ),
        Capability.HEIGHT_FIELDS: approximate(
            "prism by prism, whose sides are felt: on a level floor of cells of 0.1 m a ball at 1 m/s loses 0.06 of "
            "its speed and turns by 0.045 rad in 1.2 s, and a box stops after 0.5 to 0.9 of its way; exact where the "
            "whole field has no more than eight planes"
        ),
        Capability.COPIED_STATES: EXACT,
        Capability.DETERMINISTIC: EXACT,
        Capability.SHADOWS: approximate(
            "from a map of 6 mm squares that reaches 3 m around the middle of what moves; beyond, all is lit"
        ),
        Capability.RAY_TRACED_RGB: unsupported("MuJoCo rasterises"),
        Capability.CLOTH: approximate(
            "a flex that stretches and bends as the scene says, within 5 %; edges of solids poke through between its "
            "particles; its elasticity is integrated implicitly, which takes 9 % of a turning cloth's energy in a "
            "second; its friction creeps, a finger that opens may keep hold of it, and joint wrenches do not feel what "
            "touches it"
        ),
        Capability.ROPES: approximate(
            "a chain of stiff capsules on ball joints, which does not stretch, resists twist as it resists bending, "
            "does not roll, and does not meet the links that it is attached to in the scene; its friction creeps"
        ),
        Capability.GPU: unsupported("this backend simulates on the CPU"),
    }
)
