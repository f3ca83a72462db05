"""The capabilities of Bullet, and the reasons for what it lacks."""

from orbit_core.interfaces import EXACT, Capabilities, Capability, approximate, unsupported

_LENGTHS = (
    "Bullet adds up the lengths of a pair, each times the other's sliding friction: exact where lengths give every "
    "pair its larger one, and the nearest sums elsewhere"
)

CAPABILITIES = Capabilities(
    {
        Capability.ARTICULATIONS: EXACT,
        Capability.FLOATING_BASE: EXACT,
        Capability.IMPLICIT_DRIVES: approximate(
            "drives take both spring and damper at the end of the step (backward Euler), which is stable at any gain "
            "and damps in first order"
        ),
        Capability.EFFORT_LIMITS: EXACT,
        Capability.VELOCITY_LIMITS: unsupported("Bullet does not limit the velocity of single joints"),
        Capability.JOINT_DAMPING: EXACT,
        Capability.JOINT_SPRINGS: EXACT,
        Capability.JOINT_FRICTION: EXACT,
        Capability.ARMATURE: EXACT,
        Capability.MIMIC_JOINTS: EXACT,
        Capability.POLYNOMIAL_MIMICS: unsupported("Bullet's gears have one ratio"),
        Capability.MASSLESS_LINKS: EXACT,
        Capability.WELD_LOOPS: unsupported("welds that close loops are not connected to this backend"),
        Capability.LOOP_JOINTS: EXACT,
        Capability.SELF_COLLISIONS: EXACT,
        Capability.GRAVITY_COMPENSATION: EXACT,
        Capability.FRICTION: approximate(
            "Bullet multiplies the coefficients of a pair: exact where factors give every pair its larger one, and the "
            "nearest products elsewhere"
        ),
        Capability.STATIC_FRICTION: approximate("one coefficient of sliding friction, the dynamic one"),
        Capability.TORSIONAL_FRICTION: approximate(_LENGTHS),
        Capability.ROLLING_FRICTION: approximate(_LENGTHS),
        Capability.RESTITUTION: approximate(
            "Bullet multiplies the values of a pair, as with friction; impacts below a threshold do not rebound"
        ),
        Capability.COMPLIANT_CONTACT: approximate("stiffness and damping act at each contact point"),
        Capability.CONVEX_MESHES: approximate("a hull's edges are rounded by its margin of 1 mm"),
        Capability.TRIANGLE_MESHES: approximate(
            "balls lose speed at edges between triangles, which are made as few as the surface needs: up to 0.02 at an "
            "edge of a level floor, and 0.19 of the amplitude in a period in a bowl of facets of 50 mm"
        ),
        Capability.SIGNED_DISTANCE_FIELDS: unsupported(
            "Bullet collides moving meshes as hulls or pieces; its distance fields are read from files alone"
        ),
        Capability.DYNAMIC_TRIANGLE_MESHES: unsupported(
            "Bullet collides triangle meshes that stand still: split the mesh into convex pieces"
        ),
        Capability.HEIGHT_FIELDS: approximate(
            "edges between its triangles are felt: on a level floor of cells of 0.1 m a ball at 1 m/s loses 0.18 of "
            "its speed and turns by 0.09 rad in 1.2 s; as level as a mesh where the whole field has no more than eight "
            "planes"
        ),
        Capability.CONTACT_FORCES: EXACT,
        Capability.JOINT_WRENCHES: EXACT,
        Capability.LOOP_WRENCHES: EXACT,
        Capability.EXTERNAL_WRENCHES: EXACT,
        Capability.RAY_CASTS: approximate(
            "Bullet's search for where a ray meets a convex shape ends some millimetres off the surface"
        ),
        Capability.RANDOMIZE_MASS: EXACT,
        Capability.RANDOMIZE_CENTER_OF_MASS: unsupported("Bullet fixes a link's centre of mass when it loads it"),
        Capability.RANDOMIZE_FRICTION: approximate("Bullet multiplies the coefficients of a pair, as said of friction"),
        Capability.RANDOMIZE_GAINS: EXACT,
        Capability.RANDOMIZE_JOINTS: unsupported(
            "damping, friction and armature of joints are wheels and motors that are built with the scene"
        ),
        Capability.RANDOMIZE_LIMITS: unsupported("limits of joints are constraints that are built with the scene"),
        Capability.RANDOMIZE_GRAVITY: EXACT,
        Capability.SHAPES_PER_ENVIRONMENT: unsupported("this backend builds every environment alike"),
        Capability.SNAPSHOTS: EXACT,
        Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
        Capability.DETERMINISTIC: EXACT,
        Capability.RGB: EXACT,
        Capability.COLORS_PER_ENVIRONMENT: EXACT,
        Capability.LIGHTING: approximate(
            "as the scene says with the software renderer, renderer='tiny'; OpenGL, which 'auto' takes for colour "
            "images above 128x128 where it loads, has a light of its own, along the first light's direction"
        ),
        Capability.SHADOWS: approximate(
            "from a map of twice the picture's width, over what casts them in it, up to 3 m around the middle of what "
            "moves; single pixels beside edges differ"
        ),
        Capability.DEPTH: EXACT,
        Capability.NORMALS: approximate("computed from the depth image: blurred at the edges of things"),
        Capability.ALBEDO: EXACT,
        Capability.SEGMENTATION: EXACT,
        Capability.RAY_TRACED_RGB: unsupported("Bullet rasterises"),
        Capability.GPU: unsupported("Bullet simulates on the CPU"),
        Capability.CLOTH: approximate(
            "springs along edges, integrated explicitly, whose friction never holds what a gripper pinches: anchor it; "
            "no contact forces, snapshots or written velocities"
        ),
        Capability.ROPES: unsupported("Bullet's interface to Python makes none"),
        Capability.FLUIDS: unsupported("Bullet has none"),
        Capability.SOFT_BODIES: approximate(
            "Neo-Hookean tetrahedra, integrated explicitly; no contact forces, snapshots or written velocities"
        ),
    }
)
