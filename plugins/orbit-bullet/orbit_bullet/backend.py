"""Backend that the plugin registers: its capabilities, its declared gaps, and its engines. Bullet is imported only when
an engine or a renderer is made.
"""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_bullet.config import BulletConfig
from orbit_core.interfaces import (
    EXACT,
    Backend,
    Capabilities,
    Capability,
    ConfigurationError,
    Gap,
    approximate,
    unsupported,
)
from orbit_core.plugin_kit.simplify import SIMPLIFIED

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

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
        Capability.FRICTION_FORCES: EXACT,
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
            "as the scene says with the software renderer, renderer='tiny'; with OpenGL, which 'auto' takes for colour "
            "images above 128x128 where it loads, what lights give is computed from pictures of 8 bits: 0.9 of 255 off "
            "on average, 99 of 100 pixels within 2"
        ),
        Capability.LIGHTS_PER_ENVIRONMENT: approximate(
            "directions, colours and number, each as the scene's own light is"
        ),
        Capability.TEXTURES: approximate(
            "surfaces have no highlights; with OpenGL, colours of textured ones are within 3 of 255"
        ),
        Capability.SHADOWS: approximate(
            "from a map of twice the picture's width, over what casts them in it, up to 3 m around the middle of what "
            "moves; single pixels beside edges differ"
        ),
        Capability.DEPTH: approximate(SIMPLIFIED),
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

_RAY = "Bullet's search for where a ray meets a convex shape ends some millimetres off the surface"

_RAYS = (
    Gap("rays_on_primitives", "distance", 6e-3, _RAY),
    Gap("rays_on_primitives", "normal", 0.02, f"{_RAY}, whose normal it takes there"),
    Gap(
        "rays_on_convex_meshes",
        "distance",
        2e-3,
        "a hull's edges are rounded by its margin of 1 mm, and rays end short",
    ),
)

_TURNS = (
    "Bullet turns a body by little more than 45 degrees a step, at 5 ms some 157 rad/s; beyond, the axis wanders at "
    "constant angular momentum, as it does where a step turns a body far"
)
_UNDAMPED = (
    "joint velocities are integrated in first order, and Bullet offers no other way: a whip of a chain's end takes "
    "12 % of its energy at 5 ms, 5 % at 1.25 ms, 3 % at 0.5 ms, and the slow swings between give some"
)
_REDUCED = (
    "joint velocities are integrated in first order, and the momenta that they add up to are then conserved in first "
    "order only"
)
_BACKWARD = (
    "drives take both spring and damper at the end of the step (backward Euler), which is stable at any gain and damps "
    "in first order"
)

_LATE_STOP = (
    "a limit acts from the step after the one in which a joint passed it, by the way of one step at most: 0.1 rad at "
    "20 rad/s and 5 ms, 0.025 at 1.25 ms"
)
_RETURN = (
    "what passed a limit is pushed back by a tenth of the way a step, and keeps the speed of it: a tenth of the speed "
    "of the impact; in a scene with loops, whose share Bullet applies to limits too, up to 0.8 of it"
)

_MOTION = (
    Gap("joint_stops", "passed", 0.11, _LATE_STOP),
    Gap("joint_stops", "rebound", 0.11, _RETURN),
    Gap("floating_chain", "linear_momentum", 0.012, _REDUCED),
    Gap("floating_chain", "angular_momentum", 0.025, _REDUCED),
    Gap("floating_chain", "path", 6e-3, _REDUCED),
    Gap("floating_chain", "energy", 0.03, _REDUCED),
    Gap("fast_spin", "energy", 2.0, _TURNS),
    Gap("fast_spin", "axis", math.pi, _TURNS),
    Gap("energy_of_a_chain", "gained", 0.4, _UNDAMPED),
    Gap("energy_of_a_chain", "lost", 0.6, _UNDAMPED),
    Gap("drive_frequencies", "response", 0.5, _BACKWARD),
    Gap("implicit_drive", "under", 0.06, _BACKWARD),
    Gap("implicit_drive", "damped", 0.03, _BACKWARD),
    Gap("implicit_drive", "final", 0.015, _BACKWARD),
)

_CACHED = "cylinders and hulls stand on contact points that come and go from step to step, and tremble between them"
_LATE_IMPACT = "an impact is seen in the step after the two have met, with the speed that gravity has added by then"
_ONE_POINT = (
    "sequential impulses load one point of a face with most of the normal force; what friction the others then have "
    "does not balance its torque, and the box turns out of the grasp"
)

_ONE_POINT_OF_A_FACE = "sequential impulses load one point of a face with most of the normal force"

_EDGES = (
    "Bullet meets the edges of triangles before a ball comes to them, and their normals slow it and turn it aside; "
    "its correction of internal edges and shorter reaches of contacts cure it in part, and make boxes tremble"
)
_FIXED_DIRECTIONS = (
    "friction within a round cone has two rows along fixed directions, solved one after the other, so that feet that "
    "slide in another direction turn a tripod by 56 degrees in 0.7 s; rows along the slip, enableConeFriction=0, do "
    "not, and leave out torsional friction"
)
_REBOUND = "without restitution, what has sunk in within the step of an impact is lifted by a fifth of it in a step"

_CONTACT = (
    Gap("stopping_distance", "turn", 1.4, _FIXED_DIRECTIONS),
    Gap("oblique_impact", "rebound", 0.3, _REBOUND),
    Gap("level_mesh", "speed", 0.03, _EDGES),
    Gap("level_height_field", "speed", 0.3, _EDGES),
    Gap("level_height_field", "turn", 0.15, _EDGES),
    Gap("level_height_field", "aside", 0.06, _EDGES),
    Gap("mesh_bowl", "amplitude", 0.3, _EDGES),
    Gap("height_field_bowl", "amplitude", 0.35, _EDGES),
    Gap("stick_and_slip", "creep", 6e-3, _CACHED),
    Gap("stick_and_slip", "friction", 0.08, _CACHED),
    Gap("rolling_wheel", "downhill", 0.03, _CACHED),
    Gap("static_above_dynamic", "slip", 0.5, "there is one coefficient of sliding friction, the dynamic one"),
    Gap("spin_down", "angle", 0.16, _ONE_POINT_OF_A_FACE),
    Gap("spin_down", "way", 0.05, _ONE_POINT_OF_A_FACE),
    Gap("loaded_tower", "lean_100", 0.02, _ONE_POINT_OF_A_FACE),
    Gap("pivot_in_a_grip", "slip", 8e-3, "two rows of friction along fixed directions hold a turning contact unevenly"),
    Gap("bounce", "ball", 0.06, _LATE_IMPACT),
    Gap("bounce", "box", 0.06, _LATE_IMPACT),
    Gap("bouncing_on", "path", 0.2, _LATE_IMPACT),
    Gap(
        "puck",
        "rebound",
        0.9,
        "the first contact of a cylinder's side is a single point off its middle: the puck tips as it meets the board",
    ),
    Gap("grasp", "lift", 6e-3, _ONE_POINT),
    Gap("grasp", "limit", 0.12, _ONE_POINT),
    Gap("grasp", "creep", 0.2, _ONE_POINT),
    Gap("resting_weight", "force", 0.01, _CACHED),
    Gap("heap", "penetration", 0.05, "the many contacts of a heap are not solved to the end in 200 iterations"),
)

_IMAGES = (
    Gap("normal_images", "normal", 0.5, "normals are those of the drawn facets, from the depth of neighbouring pixels"),
    Gap("depth_images_of_dense_meshes", "depth", 0.012, SIMPLIFIED),
    Gap("depth_images_of_dense_meshes", "outline", 0.03, SIMPLIFIED),
)

_LIGHT = (
    "a light link between two wheels, that of its drive and that of its armature, is solved slowly: on the xArm's last "
    "joint 0.14 g m^2 between 32 and 21; at 1000 solver_iterations in place of 200, or at 1.25 ms, the lag is right to "
    "2.5 ms"
)

_ROBOTS = (
    Gap("robot_tracking", "gain", 0.04, _LIGHT, ("tiago_pro_gripper",)),
    Gap("robot_tracking", "lag", 0.024, _LIGHT, ("tiago_pro_gripper", "xarm7", "shadow_hand", "ur10_shadow_hand")),
)

_EXPLICIT = (
    "Bullet integrates cloth explicitly, and its cloth is refused where it is too stiff for the time step: these would "
    "take 0.09 to 2.3 ms"
)

_CLOTH = tuple(
    Gap(scenario, metric, math.inf, _EXPLICIT)
    for scenario, metrics in (
        ("cloth_hanging", ("length_7", "length_13", "length_21")),
        ("cloth_stretch", ("stretch", "contraction")),
        ("cloth_cantilever", ("droop",)),
        ("cloth_free", ("linear_momentum", "angular_momentum", "energy")),
        ("cloth_slope", ("creep", "acceleration")),
        ("cloth_edge", ("limit", "slid")),
        ("cloth_grasp", ("force", "slip")),
        ("cloth_weight", ("force",)),
        ("cloth_load", ("force", "speed")),
        ("cloth_hammock", ("force", "depth")),
    )
    for metric in metrics
)

_EXPLICIT_SOLIDS = (
    "Bullet integrates soft bodies explicitly, and those that are too stiff for the time step are refused: these would "
    "take 0.02 to 0.5 ms"
)

_SOLIDS = tuple(
    Gap(scenario, metric, math.inf, _EXPLICIT_SOLIDS)
    for scenario, metrics in (
        ("solid_beam", ("droop_soft", "droop_stiff")),
        ("solid_vibration", ("frequency", "decay", "kept")),
        ("solid_compression", ("modulus", "ratio")),
        ("solid_hertz", ("approach",)),
        ("solid_pressure", ("flat", "round")),
        ("solid_free", ("linear_momentum", "angular_momentum", "energy")),
        ("solid_slope", ("creep", "acceleration")),
        ("solid_grasp", ("force", "slip")),
        ("solid_load", ("force", "speed")),
        ("solid_stack", ("force", "speed")),
        ("solid_soft_slope", ("creep", "acceleration")),
        ("solid_draped", ("force", "speed")),
        ("solid_ring", ("overlap", "open")),
    )
    for metric in metrics
)

GAPS: tuple[Gap, ...] = (
    *_CLOTH,
    *_SOLIDS,
    *_RAYS,
    *_IMAGES,
    *_CONTACT,
    *_MOTION,
    *_ROBOTS,
)

DISTRIBUTIONS = ("pybullet", "pybullet-arm64")
"""Any of them brings the module ``pybullet``."""


class BulletBackend(Backend):
    """Bullet on the CPU, one process per core."""

    name: ClassVar[str] = "bullet"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = BulletConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for name in DISTRIBUTIONS:
            try:
                found[name] = importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                continue
        return found

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: BulletConfig) -> Engine:
        if device.type != "cpu":
            raise ConfigurationError(f"backend 'bullet' simulates on device 'cpu' only, not on '{device}'")
        from orbit_bullet.engine import BulletEngine

        return BulletEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: BulletConfig) -> Renderer:
        from orbit_bullet.renderer import BulletRenderer

        return BulletRenderer(layout, cameras, config)
