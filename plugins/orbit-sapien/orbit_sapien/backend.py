"""Backend that the plugin registers: its capabilities, its declared gaps, and its engines. SAPIEN is imported only when
an engine or a renderer is made.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import (
    EXACT,
    MATTER,
    Backend,
    Capabilities,
    Capability,
    ConfigurationError,
    Gap,
    UnsupportedCapabilityError,
    approximate,
    unsupported,
)
from orbit_core.plugin_kit.workers import split_evenly, worker_count
from orbit_sapien.config import PathConfig, RasterConfig, SapienConfig

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

FEWEST_PER_WORKER = 8
"""Environments for which a process of its own pays."""

_SHADOW_MAP = "from a map of 6 mm squares that reaches 3 m around the middle of what moves; beyond, all is lit"
_LINEAR = "reckons in linear light: right within 4 of 255 where no directional light falls, elsewhere 8 to 33 brighter"

_IMAGES = {
    Capability.RGB: EXACT,
    Capability.COLORS_PER_ENVIRONMENT: EXACT,
    Capability.LIGHTING: EXACT,
    Capability.LIGHTS_PER_ENVIRONMENT: EXACT,
    Capability.TEXTURES: approximate(
        "no highlights in the tier 'fast'; a colour that a link is given in one environment does not show on its "
        "textured surfaces"
    ),
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
        Capability.FRICTION_FORCES: unsupported("PhysX reports normal contact forces only"),
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
            "a run repeats bit for bit with the same environments in each PhysX world; with others, PhysX's TGS solver "
            "sums contacts in another order, and they differ in the last bit; with envs_per_world=1 none depends on any"
        ),
        **(_IMAGES | {Capability.RAY_TRACED_RGB: EXACT}),
        Capability.GPU: unsupported(
            "untested: PhysX's GPU library is no part of SAPIEN's package and was never at hand; where it is installed "
            "(python -m orbit_sapien.physx_gpu), device 'cuda' runs code that no GPU has run"
        ),
        **dict.fromkeys(MATTER, unsupported("SAPIEN has no deformable bodies")),
    }
)

_PRISM = (
    "PhysX has no cylinders: SAPIEN's are prisms of 32 sides, which lose speed at each edge that they roll over; of "
    "1 m/s a wheel of 0.1 m radius keeps 0.36 after 2 s in steps of 2 ms, and 0.28 in steps of 5 ms"
)

_RAYS = (
    Gap(
        "rays_on_primitives", "distance", 1e-4,
        "PhysX casts rays in single precision: one that glances the ground meets it at 10.3 m 6e-5 m off",
    ),
)  # fmt: skip

_LOADED_DRIVE = (
    "friction under a drive is a force that PhysX applies at the beginning of a step, at whose end the drive has not "
    "caught up with it"
)

_UNDAMPED = (
    "PhysX integrates joints in first order, in single precision: energy comes and goes, and in 20 s 0.6 of it is lost "
    "in steps of 5 ms, 0.4 in steps of 2 ms; neither PGS nor other iterations keep it"
)
_GYROSCOPIC = (
    "a first-order step does not hold the nutation where the wheel turns by 17 degrees in one; in steps of 0.5 ms the "
    "precession is right within 4e-4, in steps of 1 ms it is not"
)
_FAST_BODY = (
    "gyroscopic torques are taken at the beginning of the step: a body that turns by more than some degrees in one "
    "tumbles out of its axis and loses its energy, and never gains any"
)

_SPRUNG_DRIVE = (
    "a spring beside a drive is a force at the beginning of the step, with which the drive has not caught up"
)

_SMALL_STEPS = (
    "PhysX applies a drive in 24 small steps of its own, of which it reports the last: the mean position over them is "
    "that of a cubic"
)
_ITERATED = (
    "PhysX solves the drives of a chain one after the other and ends short of their balance: the reported effort is "
    "that of the drive's law, 12 % of the largest one off at 5 ms and 3 % at 1.25 ms; force-torque sensors are exact"
)

_MOTION = (
    Gap("applied_effort", "stiff", 5e-3, _SMALL_STEPS),
    Gap("applied_effort", "velocity", 1e-3, _SMALL_STEPS),
    Gap("applied_effort", "limited", 2e-3, _SMALL_STEPS),
    Gap("applied_effort", "geared", 2e-3, _SMALL_STEPS),
    Gap("applied_effort", "dragged", 2e-3, _SMALL_STEPS),
    Gap("applied_effort", "chain", 0.2, _ITERATED),
    Gap("joint_springs", "driven", 0.01, _SPRUNG_DRIVE),
    Gap("projectile", "spin", 1.5e-3, "PhysX reckons in single precision, and rounds 5e-7 of a spin off at each step"),
    Gap("energy_of_a_chain", "gained", 0.5, _UNDAMPED),
    Gap("energy_of_a_chain", "lost", 1.0, _UNDAMPED),
    Gap("gyroscope", "precession", 0.5, _GYROSCOPIC),
    Gap("gyroscope", "level", 1.6, _GYROSCOPIC),
    Gap("gyroscope", "spin", 0.6, _GYROSCOPIC),
    Gap("fast_spin", "angular_momentum", 3.0, _FAST_BODY),
    Gap("fast_spin", "energy", 2.0, _FAST_BODY),
    Gap("fast_spin", "axis", 3.2, _FAST_BODY),
    Gap("joint_friction", "driven", 2e-3, _LOADED_DRIVE),
)

_LATE_WRENCH = "PhysX's joint force is of the beginning of a step, in axes that have turned by omega dt at its end"

_ANOTHER_ORDER = (
    "PhysX's TGS solver sums contacts in another order: last digits differ, and then what a strike comes to"
)

_SENSORS = (
    Gap("imu_falling_and_at_rest", "resting", 0.01, "a resting body's velocity flickers in its last digits, 1e-5 m/s"),
    Gap("force_torque_of_a_spinning_arm", "force", 0.15, _LATE_WRENCH),
    Gap("force_torque_of_a_spinning_arm", "torque", 0.06, _LATE_WRENCH),
    Gap("alone_and_among_seven", "difference", 2.0, _ANOTHER_ORDER),
    Gap("every_environment", "difference", 2.0, _ANOTHER_ORDER),
    Gap(
        "snapshot", "difference", 0.5,
        "loading drops what PhysX remembers of contacts, which it does not give away: the first difference is of 1e-6 "
        "m, and a strike later of 0.05 m/s",
    ),
)  # fmt: skip

_TOLD = (
    "velocities of joints are those of the TGS solver's last sub-step: fingers that press on a box are told to move, "
    "at 0.02 m/s in steps of 5 ms and 0.0015 in steps of 1 ms, and do not; those of free bodies are the motion's"
)
_GRIP = (
    "the torque on a bar held by two tips is short by a part that is in proportion to the step: it creeps at 0.2 rad/s "
    "in steps of 5 ms, at 0.04 in steps of 1 ms"
)
_BALANCE = (
    "the torque is exact, but the cylinder balances on the dome's top for 0.1 s alone: rounding in single precision "
    "tips the fast spin over"
)

_TAKEN_BACK = (
    "the TGS solver's friction takes back what slid since the beginning of the step, before the two had touched: a "
    "ball that rough ground stops from slipping has 0.83 to 1.04 of its impulse, by the part of the step at which it "
    "lands"
)
_FEET = "feet of a tripod that slides are loaded by turns: it turns by 3 degrees in 0.25 s"

_CONTACT = (
    Gap("oblique_impact", "rolling", 0.2, _TAKEN_BACK),
    Gap("stopping_distance", "turn", 0.12, _FEET),
    Gap("velocity_told", "grasp", 0.05, _TOLD),
    Gap("requested_torsional_friction", "cylinder", 0.5, _BALANCE),
    Gap("torsional_grip", "creep", 0.4, _GRIP),
    Gap("torsional_grip", "turning", 0.3, _GRIP),
    Gap("rolling_wheel", "level", 0.6, _PRISM),
    Gap("rolling_wheel", "aside", 0.02, _PRISM),
    Gap("rolling_wheel", "downhill", 0.3, _PRISM),
    Gap("rolling_coin", "path", 3.0, _PRISM),
    Gap("rolling_coin", "lean", 3.0, _PRISM),
    Gap(
        "static_above_dynamic", "slip", 0.5,
        "PhysX's TGS solver lets a face slip before its whole normal force is there, and then takes the dynamic "
        "coefficient; its PGS, temporal_gauss_seidel=False, holds",
    ),
    Gap("contact_force_with_friction", "force", 0.5, "PhysX tells contacts' normal forces, not those of friction"),
    Gap("sheared_tactile_pad", "shear", 0.33, "PhysX tells contacts' normal forces, not those of friction"),
)  # fmt: skip

GAPS: tuple[Gap, ...] = (
    *_RAYS,
    *_CONTACT,
    *_SENSORS,
    *_MOTION,
)


class SapienBackend(Backend):
    """PhysX 5 on the CPU, in one or more processes."""

    name: ClassVar[str] = "sapien"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = SapienConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        import importlib.metadata

        return {"sapien": importlib.metadata.version("sapien")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> Engine:
        if device.type == "cuda":
            from orbit_sapien.gpu_engine import SapienGpuEngine

            return SapienGpuEngine(layout, num_envs, device, config)
        if device.type != "cpu":
            raise ConfigurationError(f"backend '{self.name}' simulates on device 'cpu' or 'cuda', not on '{device}'")
        from orbit_sapien.engine import SapienEngine

        size = config.envs_per_world
        workers = worker_count(config.workers, -(-num_envs // size), num_envs // FEWEST_PER_WORKER)
        if workers == 1:
            return SapienEngine(layout, num_envs, device, config)
        from orbit_core.plugin_kit.split_engine import SplitEngine

        return SplitEngine(SapienEngine, layout, num_envs, config, split_evenly(num_envs, workers, size))

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: SapienConfig) -> Renderer:
        from orbit_sapien.renderer import SapienRenderer

        return SapienRenderer(layout, cameras, config)


# Tiers are backends, so that a world of any engine can be drawn by one of them by its name.
class _Tier(SapienBackend):
    """One tier of the renderer under a separate name, for worlds that any backend simulates."""

    tier: ClassVar[str]
    config_type: ClassVar[type] = RasterConfig

    def capabilities(self) -> Capabilities:
        return FAST_IMAGES

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> Engine:
        raise UnsupportedCapabilityError(f"'{self.name}' draws and simulates nothing: use backend 'sapien' for physics")

    def create_renderer(
        self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: RasterConfig | PathConfig
    ) -> Renderer:
        return super().create_renderer(layout, cameras, SapienConfig(tier=self.tier, **dataclasses.asdict(config)))


class SapienFast(_Tier):
    """Rasterised, by Lambert's law, with shadows."""

    name, tier = "sapien-fast", "fast"
    """Name of the shaders that draw."""


class SapienPbr(_Tier):
    """Rasterised with physically based materials."""

    name, tier = "sapien-pbr", "pbr"
    """Name of the shaders that draw."""

    def capabilities(self) -> Capabilities:
        return PBR_IMAGES


class SapienRt(_Tier):
    """Traced paths."""

    name, tier = "sapien-rt", "rt"
    """Name of the shaders that draw."""
    config_type: ClassVar[type] = PathConfig

    def capabilities(self) -> Capabilities:
        return TRACED_IMAGES
