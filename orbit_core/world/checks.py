"""Checks of a world: memory before the engine is built, and the built model after."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree, link_ancestry
from orbit_core.dynamics.transforms import quat_distance
from orbit_core.interfaces import BuildError, BuiltModel, ConfigurationError, Engine, EntityLayout, SceneLayout
from orbit_core.plugin_kit.memory import free_bytes, size_label
from orbit_core.scene import CameraSpec, Channel

# Bytes that an engine takes at least per link or joint of an environment: its state, the core's, and contacts
_PER_BODY = 2048
# Bytes of a particle of matter: position, displacement, velocity, what it is held by and what it is near
_PER_PARTICLE = 128
_PER_PIXEL = {
    Channel.RGB: 3,
    Channel.DEPTH: 4,
    Channel.POSITION: 4,  # made from depth
    Channel.NORMALS: 12,
    Channel.ALBEDO: 3,
    Channel.INSTANCE: 4,
    Channel.SEMANTIC: 4,
}
_COPIES = 2  # what the renderer draws into, and what the sensor holds


def check_capacity(layout: SceneLayout, num_envs: int, device: torch.device) -> None:
    """Refuse more environments than can fit; an engine that takes more than the least checks that itself.

    Raises:
        ConfigurationError: says how many fit, which part is pictures, and how many particles would fit.
    """
    pictures = sum(_picture_bytes(spec) for spec in layout.scene.sensors if isinstance(spec, CameraSpec))
    particles = sum(len(spec.rest_positions) for spec in layout.scene.deformables)
    each = pictures + _PER_BODY * (len(layout.links) + len(layout.joints) + 1) + _PER_PARTICLE * particles
    free = free_bytes(device)
    if num_envs * each > free:
        cameras = f", {size_label(num_envs * pictures)} of it for the cameras' pictures" if pictures else ""
        remedy = " or smaller pictures" if pictures else ""
        matter = _PER_PARTICLE * particles
        if matter > 0.5 * each:
            fitting = max(0, free // num_envs - each + matter) // _PER_PARTICLE
            remedy += f", or for coarser meshes: {particles:,} particles in each, of which {fitting:,} fit"
        raise ConfigurationError(
            f"{num_envs} environments take {size_label(num_envs * each)} or more{cameras}, and {size_label(free)} are "
            f"free on '{device}': at most {free // each} fit; ask for fewer{remedy}"
        )


def _picture_bytes(spec: CameraSpec) -> int:
    held = 1 + round(spec.delay * spec.rate) if spec.rate else 1
    return spec.width * spec.height * sum(_PER_PIXEL[channel] for channel in spec.channels) * (_COPIES + held - 1)


FloatArray = npt.NDArray[np.float64]

# Tolerances of links: metres, per metre of distance from the origin where that is more, and radians. Engines compute in
# single precision, some of them far from the origin
_LENGTH, _ANGLE = 2e-4, 2e-3
# Radians or metres, of joint positions
_TOLD = 1e-4
# Relative tolerance of masses, limits and armatures, and of inertias by the largest moment
_RELATIVE = 1e-4
# Metres, of centres of mass
_CENTER = 1e-5
_UNLIMITED = 1e8
# Fraction of a joint's range, up or down from home, at which kinematics are compared a second time
_STRAY = 0.381966


def check_build(engine: Engine, backend: str) -> None:
    """Hold a new engine to its layout; it is in the scene's initial state afterwards.

    Raises:
        BuildError: names the backend, what is wrong, by how much and what it should be.
    """
    problems = itertools.chain(_wrong_numbers(engine), _wrong_poses(engine))
    problem = next(problems, None)
    if problem is not None:
        raise BuildError(
            f"backend '{backend}' built the scene wrong: {problem}; the fault is the plugin's, and it would simulate "
            "another scene than this: tell its authors, and choose another backend"
        )


def _wrong_numbers(engine: Engine) -> Iterator[str]:
    kinds, built = engine.layout.variants, engine.built_model()
    if len(built) != len(kinds):
        yield f"it tells of {len(built)} kinds of environments where the scene has {len(kinds)}"
    for layout, model in zip(kinds, built, strict=False):
        yield from _wrong_inertias(layout, model)
        yield from _wrong_joints(layout, model)


def _wrong_inertias(layout: SceneLayout, model: BuiltModel) -> Iterator[str]:
    for entity in layout.entities:
        for number in range(entity.links.start, entity.links.stop):
            link = layout.links[number]
            if entity.spec.fixed_base and number == entity.root_link:
                continue
            subject = f"of link '{link.name}' of '{entity.name}'"
            if link.mass == 0:
                yield from _wrong_stand_in(entity, number, model)
                continue
            if not np.isclose(model.masses[number], link.mass, rtol=_RELATIVE, atol=0.0):
                yield f"the mass {subject} is {model.masses[number]:.6g} kg instead of {link.mass:.6g}"
            center = model.centers_of_mass[number]
            if not np.allclose(center, link.center_of_mass, rtol=_RELATIVE, atol=_CENTER):
                yield f"the centre of mass {subject} is at {_shown(center)} m instead of {_shown(link.center_of_mass)}"
            if model.inertias is None:
                continue
            inertia = np.asarray(link.inertia, dtype=np.float64)
            largest = np.linalg.eigvalsh(inertia)[2]
            if not np.allclose(model.inertias[number], inertia, rtol=0.0, atol=10 * _RELATIVE * largest):
                off = np.abs(model.inertias[number] - inertia).max() / largest
                yield f"the inertia {subject} is {off:.2g} of its largest moment, {largest:.4g} kg m^2, off"


def _wrong_stand_in(entity: EntityLayout, number: int, model: BuiltModel) -> Iterator[str]:
    """A link without mass may be built with so little mass and inertia that what it carries has far more."""
    articulation = entity.spec.articulation
    index = number - entity.root_link
    carried = [
        link for link, above in zip(articulation.links, link_ancestry(articulation), strict=True) if above[index]
    ]
    subject = f"of link '{articulation.links[index].name}' of '{entity.name}'"
    most = _RELATIVE * sum(link.mass for link in carried)
    if model.masses[number] > most:
        yield f"the mass {subject} is {model.masses[number]:.6g} kg instead of none, and {most:.3g} would be too much"
    if model.inertias is None:
        return
    most = _RELATIVE * sum(float(np.linalg.eigvalsh(link.inertia)[-1]) for link in carried)
    largest = float(np.abs(model.inertias[number]).max())
    if largest > most:
        yield f"the inertia {subject} is {largest:.6g} kg m^2 instead of none, and {most:.3g} would be too much"


def _wrong_joints(layout: SceneLayout, model: BuiltModel) -> Iterator[str]:
    asked = layout.joint_parameters
    pairs = {
        "lower limit": (model.lower_limits, asked.lower_limit),
        "upper limit": (model.upper_limits, asked.upper_limit),
        "armature": (model.armatures, asked.armature),
        "effort limit": (model.effort_limits, asked.effort_limit),
    }
    for what, (got, wanted) in pairs.items():
        if got is None:
            continue
        for number in np.flatnonzero(_differ(got, wanted)):
            joint, entity = layout.joints[number], _entity_of_joint(layout, int(number))
            yield (
                f"the {what} of joint '{joint.name}' of '{entity.name}' is {got[number]:.6g} instead of "
                f"{wanted[number]:.6g}"
            )


def _differ(got: FloatArray, wanted: FloatArray) -> npt.NDArray[np.bool_]:
    got, wanted = (np.where(np.abs(a) >= _UNLIMITED, np.copysign(np.inf, a), a) for a in (got, wanted))
    return ~np.isclose(got, wanted, rtol=_RELATIVE, atol=1e-6)


def _wrong_poses(engine: Engine) -> Iterator[str]:
    """Compare all environments at home, then the last one with its joints moved, which is put back after."""
    parameters = engine.layout.joint_parameters
    home = torch.as_tensor(parameters.home, dtype=torch.float32, device=engine.device).repeat(engine.num_envs, 1)
    yield from _misplaced(engine, home, "at home")
    if not home.shape[1]:
        return
    last = torch.tensor([engine.num_envs - 1], device=engine.device)
    moved = home.clone()
    moved[-1] = torch.as_tensor(_positions_elsewhere(engine.layout))
    engine.write_joint_state(torch.arange(home.shape[1], device=engine.device), moved[-1:], None, last)
    yield from _misplaced(engine, moved, "with the joints of the last environment moved")
    engine.reset(last)


def _positions_elsewhere(layout: SceneLayout) -> FloatArray:
    """(J,) within limits, mimic joints with their leaders; joints of closed loops stay at home."""
    parameters = layout.joint_parameters
    home = parameters.home
    below = np.maximum(parameters.lower_limit, home - 1.0) - home
    above = np.minimum(parameters.upper_limit, home + 1.0) - home
    positions = home + _STRAY * np.where(above > -below, above, below)
    for entity in layout.entities:
        articulation, start = entity.spec.articulation, entity.joints.start
        if articulation.loops:
            positions[entity.joints] = home[entity.joints]
            continue
        for index, joint in enumerate(articulation.movable_joints):
            if joint.mimic is not None:
                leader = positions[start + articulation.joint_names.index(joint.mimic.joint)]
                positions[start + index] = joint.mimic.position(leader)
    return positions


def _misplaced(engine: Engine, positions: Tensor, when: str) -> Iterator[str]:
    """Yield joints whose positions differ from those (N, J) that were written, and links that do not follow them."""
    off = (engine.joint_positions - positions).abs() > _TOLD
    for env, joint in off.nonzero().tolist():
        name, entity = engine.layout.joints[joint].name, _entity_of_joint(engine.layout, joint)
        told, given = float(engine.joint_positions[env, joint]), float(positions[env, joint])
        yield f"{when}, joint '{name}' of '{entity.name}' in environment {env} tells {told:.6g} instead of {given:.6g}"
    for entity in engine.layout.entities:
        root = torch.tensor((*entity.spec.pose.position, *entity.spec.pose.orientation), device=engine.device)
        tree = KinematicTree(entity.spec.articulation, engine.device)
        asked = tree.forward(root.expand(engine.num_envs, 7), positions[:, entity.joints])
        built = engine.link_poses[:, entity.links]
        distance = (built[..., :3] - asked[..., :3]).norm(dim=-1)
        angle = quat_distance(built[..., 3:], asked[..., 3:])
        right = (distance <= _LENGTH * asked[..., :3].norm(dim=-1).clamp_min(1.0)) & (angle <= _ANGLE)
        for env, link in (~right).nonzero().tolist():
            name = entity.spec.articulation.link_names[link]
            yield (
                f"{when}, link '{name}' of '{entity.name}' in environment {env} stands {distance[env, link]:.3g} m and "
                f"{angle[env, link]:.3g} rad off, at {_shown(built[env, link, :3].cpu())} m instead of "
                f"{_shown(asked[env, link, :3].cpu())}"
            )


def _entity_of_joint(layout: SceneLayout, joint: int) -> EntityLayout:
    return next(entity for entity in layout.entities if entity.joints.start <= joint < entity.joints.stop)


def _shown(vector: object) -> str:
    return "(" + ", ".join(f"{float(x):.4g}" for x in np.asarray(vector)) + ")"
