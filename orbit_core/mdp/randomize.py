"""Events that make environments differ in what a policy has no way to know, and curricula that widen the differences.

Why: Tobin et al., Domain Randomization for Transferring Deep Neural Networks from Simulation to the Real World (2017);
Peng et al., Sim-to-Real Transfer of Robotic Control with Dynamics Randomization (2018).

Masses, friction and gains outlast resets; each draw starts from the scene's own values. At
:attr:`~orbit_core.envs.EventTime.STARTUP` an environment keeps what it drew, at
:attr:`~orbit_core.envs.EventTime.RESET` each episode draws again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.terms import EventFunction, TermFunction
from orbit_core.interfaces import ConfigurationError, LightTable, Object, UnknownNameError, World
from orbit_core.scene import Texture
from orbit_core.scene.pose import Vector3
from orbit_core.sensors import CameraSensor

TERRAIN = "terrain"


@dataclass(frozen=True)
class Range:
    """Uniform in [``low``, ``high``). With ``easy``, the range opens from that one value as the difficulty grows."""

    low: float
    high: float
    easy: float | None = None

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ConfigurationError(f"a range needs low <= high, not {self.low:g} and {self.high:g}")

    def sample(self, env: Environment, shape: tuple[int, ...], env_ids: Tensor) -> Tensor:
        """(n, *shape) drawn from the environments' own streams."""
        if self.easy is None:
            return env.world.random.uniform(shape, self.low, self.high, env_ids)
        # One difficulty for all components of an environment's draw.
        difficulty = env.state.difficulty[env_ids].view(-1, *(1 for _ in shape))
        # Drawn in [0, 1) and scaled afterwards, so that the same draw means the same share of the range at any
        # difficulty.
        share = env.world.random.uniform(shape, env_ids=env_ids)
        return self.easy + difficulty * (self.low + (self.high - self.low) * share - self.easy)


def masses(entity: str, scale: Range, links: Sequence[str] = (".*",)) -> EventFunction:
    """Scale the masses of an entity's links, whose names match, each by its own factor; inertias follow.

    Links that have no mass, as a fixed base may, keep to themselves.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        bodies = thing.spec.articulation.links
        # Links without mass have none to scale.
        chosen = [link for link in thing.find_links(*links) if bodies[link].mass > 0.0]
        factors = scale.sample(env, (len(chosen),), env_ids)
        thing.set_masses(thing.nominal_masses[env_ids][:, chosen] * factors, chosen, env_ids)

    return event


def friction(entities: Sequence[str], coefficient: Range) -> EventFunction:
    """One coefficient, static and dynamic alike, for all shapes of the entities named; ``"terrain"`` is one.

    Name both sides of a contact: the larger of their coefficients holds, and engines that combine them otherwise agree
    where both are the same.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        # One draw for all names: the two sides of a contact must have the same coefficient.
        drawn = coefficient.sample(env, (1,), env_ids)
        for name in entities:
            if name == TERRAIN:
                env.world.set_terrain_friction(drawn[:, 0], env_ids)
            else:
                thing = _entity(env.world, name)
                # All links alike, which every engine can do, even one with a coefficient for a whole body.
                thing.set_friction(drawn.expand(-1, len(thing.link_names)), env_ids=env_ids)

    return event


def gains(entity: str, stiffness: Range, damping: Range, joints: Sequence[str] = (".*",)) -> EventFunction:
    """Scale the stiffness and the damping of the actuators of joints whose names match, each by its own factor.

    Joints without an actuator keep to themselves.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        nominal = thing.nominal_gains
        chosen = [joint for joint in thing.find_joints(*joints) if joint in nominal]
        # Factors apply to the description's gains and not to the last ones, which would drift from episode to episode.
        own = torch.tensor([nominal[joint] for joint in chosen], device=env.device)
        values = [
            column * factor.sample(env, (len(chosen),), env_ids)
            for column, factor in zip(own.unbind(1), (stiffness, damping), strict=True)
        ]
        thing.set_gains(values[0], values[1], chosen, env_ids)

    return event


def joint_parameters(
    entity: str,
    damping: Range | None = None,
    friction: Range | None = None,
    armature: Range | None = None,
    stiffness: Range | None = None,
    joints: Sequence[str] = (".*",),
) -> EventFunction:
    """Scale damping, Coulomb friction, armature and springs' stiffness of joints whose names match, by factors of each.

    What is None keeps to itself, and what is zero in the scene stays zero.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot; names the backends that can.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        chosen, parameters = thing.find_joints(*joints), env.world.layout.joint_parameters
        (own,) = (each for each in env.world.layout.entities if each.name == entity)
        # The layout numbers joints of all entities, and a robot its own.
        columns = [own.joints.start + joint for joint in chosen]
        values: dict[str, Tensor] = {}
        own_values = {
            "damping": (damping, parameters.damping),
            "friction": (friction, parameters.friction),
            "armature": (armature, parameters.armature),
            "stiffness": (stiffness, parameters.spring_stiffness),
        }
        for name, (scale, scenes) in own_values.items():
            if scale is not None:
                nominal = torch.as_tensor(scenes[columns], dtype=torch.float32, device=env.device)
                values[name] = nominal * scale.sample(env, (len(chosen),), env_ids)
        thing.set_joint_parameters(**values, joints=chosen, env_ids=env_ids)

    return event


def joint_limits(
    entity: str, lower: Range | None = None, upper: Range | None = None, joints: Sequence[str] = (".*",)
) -> EventFunction:
    """Shift the lower and the upper limits of joints whose names match, each by its own draw (rad or m).

    Commands keep to the scene's limits; an upper limit below the lower one is set to it.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot; names the backends that can.
        ConfigurationError: a joint has no limits in the scene.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        chosen = thing.find_joints(*joints)
        scenes = thing.position_limits[list(chosen)].expand(len(env_ids), -1, -1)
        low, high = (
            limit if shift is None else limit + shift.sample(env, (len(chosen),), env_ids)
            for limit, shift in zip(scenes.unbind(-1), (lower, upper), strict=True)
        )
        # Independent shifts may cross where the range is narrow, and engines refuse limits in the wrong order.
        thing.set_joint_limits(low, torch.maximum(low, high), chosen, env_ids)

    return event


def colors(
    entities: Sequence[str],
    low: Vector3 = (0.0, 0.0, 0.0),
    high: Vector3 = (1.0, 1.0, 1.0),
    links: Sequence[str] = (".*",),
) -> EventFunction:
    """Give links whose names match a colour each, its red, green and blue between ``low`` and ``high``, in pictures.

    Raises, when it happens:
        UnsupportedCapabilityError: the renderer cannot; names those that can.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        for name in entities:
            thing = _entity(env.world, name)
            chosen = thing.find_links(*links)
            drawn = env.world.random.uniform((len(chosen), 3), low, high, env_ids)
            thing.set_colors(drawn, chosen, env_ids)

    return event


def textures(entities: Sequence[str], choices: Sequence[Texture], links: Sequence[str] = (".*",)) -> EventFunction:
    """Give links whose names match one of these textures each, in pictures (:mod:`orbit_assets.textures`).

    Raises:
        ConfigurationError: there are no choices.

    Raises, when it happens:
        UnsupportedCapabilityError: the renderer cannot; names those that can.
    """
    if not choices:
        raise ConfigurationError("randomize.textures needs one texture at least: see orbit_assets.textures")

    def event(env: Environment, env_ids: Tensor) -> None:
        for name in entities:
            thing = _entity(env.world, name)
            chosen = thing.find_links(*links)
            drawn = env.world.random.uniform((len(chosen),), 0.0, float(len(choices)), env_ids).long()
            # In single precision a draw just below the number of choices may round to it.
            thing.set_textures(choices, drawn.clamp_max(len(choices) - 1), chosen, env_ids)

    return event


def lights(
    tilt: float = 0.6,
    intensity: Range = Range(0.6, 1.3),
    low: Vector3 = (0.85, 0.85, 0.85),
    high: Vector3 = (1.0, 1.0, 1.0),
    ambient: Range = Range(0.7, 1.2),
    shown: float = 1.0,
) -> EventFunction:
    """Turn, colour, dim and switch the scene's directional lights, and dim its ambient light, in colour images.

    Args:
        tilt: radians by which a light is turned at most, any way.
        intensity: factor of a light's own intensity.
        low: least red, green and blue of a light's colour, which multiplies its own.
        high: most of them.
        ambient: factor of the ambient light.
        shown: probability that a light is on, each by itself: how many there are.

    Raises, when it happens:
        UnsupportedCapabilityError: the renderer cannot; names those that can.
    """
    _check_tilt(tilt, "lights")

    def event(env: Environment, env_ids: Tensor) -> None:
        world, own = env.world, env.world.nominal_lights.rows(env_ids)
        count = own.directions.shape[1]
        random = world.random
        turned = _tilted(env, own.directions, tilt, env_ids)
        on = random.uniform((count, 1), env_ids=env_ids) < shown
        factor = intensity.sample(env, (count, 1), env_ids) * random.uniform((count, 3), low, high, env_ids) * on
        around = own.ambient * ambient.sample(env, (1,), env_ids)
        world.set_lights(LightTable(around, turned, own.radiance * factor), env_ids)

    return event


def camera_pose(camera: str, position: float = 0.02, rotation: float = 0.05) -> EventFunction:
    """Move a camera of the scene by up to ``position`` metres along each axis and ``rotation`` radians about it.

    Raises, when it happens:
        UnknownNameError: the scene has no such camera.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        moved = env.world.random.uniform((3,), -position, position, env_ids)
        half = 0.5 * env.world.random.uniform((3,), -rotation, rotation, env_ids)
        turn = torch.cat((torch.ones_like(half[:, :1]), half), dim=1)
        turn = turn / turn.norm(dim=1, keepdim=True)
        _camera(env.world, camera).displace(torch.cat((moved, turn), dim=1), env_ids)

    return event


def camera_field_of_view(camera: str, vertical_fov: Range) -> EventFunction:
    """Give a camera of the scene another vertical field of view (rad): its intrinsics.

    Raises, when it happens:
        UnknownNameError: the scene has no such camera.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        drawn = vertical_fov.sample(env, (), env_ids)
        _camera(env.world, camera).set_vertical_fov(drawn, vertical_fov.high, env_ids)

    return event


def distractors(
    entities: Sequence[str], low: Vector3, high: Vector3, shown: float = 1.0, away: Vector3 = (30.0, 0.0, 0.5)
) -> EventFunction:
    """Place objects that a task does not need at random, turned about the vertical, or put them out of sight.

    Args:
        entities: objects with a free root.
        low: least x, y and z (m) of an object's root, in the environment's frame.
        high: most of them.
        shown: probability that an object is there.
        away: place (m) of the first one that is not; others stand in a row behind it.

    Raises, when it happens:
        ConfigurationError: the base of one is fixed.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        random = env.world.random
        for number, name in enumerate(entities):
            thing = _entity(env.world, name)
            if thing.spec.fixed_base:
                raise ConfigurationError(f"'{name}' cannot be a distractor: its base is fixed; name another object")
            hidden = torch.tensor((away[0] + number, away[1], away[2]), device=env.device)
            there = random.uniform((1,), env_ids=env_ids) < shown
            place = torch.where(there, random.uniform((3,), low, high, env_ids), hidden)
            half = 0.5 * random.uniform((1,), -torch.pi, torch.pi, env_ids)
            zero = torch.zeros_like(half)
            thing.set_root_pose(torch.cat((place, half.cos(), zero, zero, half.sin()), dim=1), env_ids)
            thing.set_root_velocity(torch.zeros(len(place), 6, device=env.device), env_ids)

    return event


def centers_of_mass(entity: str, shift: Range, links: Sequence[str] = (".*",)) -> EventFunction:
    """Shift the centres of mass of links whose names match, along each of their axes by its own draw (m).

    Links that have no mass keep to themselves.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot; names the backends that can.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        bodies = thing.spec.articulation.links
        chosen = [link for link in thing.find_links(*links) if bodies[link].mass > 0.0]
        own = torch.tensor([bodies[link].center_of_mass for link in chosen], device=env.device)
        thing.set_centers_of_mass(own + shift.sample(env, (len(chosen), 3), env_ids), chosen, env_ids)

    return event


def gravity(change: Range, tilt: float = 0.0) -> EventFunction:
    """Change gravity: its length by a factor, and its direction by up to ``tilt`` radians, any way.

    Raises, when it happens:
        UnsupportedCapabilityError: the engine cannot.
    """
    _check_tilt(tilt, "gravity")

    def event(env: Environment, env_ids: Tensor) -> None:
        own = env.world.layout.scene.gravity
        length = math.hypot(*own)
        # Without gravity there is nothing to turn, and any direction will do.
        down = (
            torch.tensor(own, device=env.device) / length if length else torch.tensor((0.0, 0.0, -1.0)).to(env.device)
        )
        turned = length * _tilted(env, down[None, None], tilt, env_ids)[:, 0]
        env.world.set_gravity(turned * change.sample(env, (1,), env_ids), env_ids)

    return event


def active_model(entity: str, name: str, parameter: str, scale: Range) -> EventFunction:
    """Scale a parameter of one of an object's active models, such as the ``force`` of a seal.

    Raises, when it happens:
        UnknownNameError: the object has no such model, or that no such parameter.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        model = _entity(env.world, entity).active[name]
        if parameter not in model.nominal:
            raise UnknownNameError("parameter", parameter, model.nominal, f"active model '{name}' of '{entity}'")
        values = model.nominal[parameter] * scale.sample(env, (), env_ids)
        model.set_parameter(parameter, values, env_ids)

    return event


# A factor and its inverse: as much softer as stiffer.
def uncertain_gains(entity: str) -> EventFunction:
    """Scale stiffness and damping of all actuators by 0.8 to 1.25: how well a real robot's are known, as a rule."""
    return gains(entity, stiffness=Range(0.8, 1.25), damping=Range(0.8, 1.25))


def push(entity: str, speed: Range) -> EventFunction:
    """Add a horizontal velocity of that speed (m/s), in any direction, to the entity's root.

    Raises, when it happens:
        ConfigurationError: the entity's base is fixed.
    """

    def event(env: Environment, env_ids: Tensor) -> None:
        thing = _entity(env.world, entity)
        if thing.spec.fixed_base:
            # Checked when it happens, because the event is made before the scene is.
            raise ConfigurationError(f"'{entity}' cannot be pushed: its base is fixed; name another entity")
        angle = env.world.random.uniform((), -torch.pi, torch.pi, env_ids)
        change = speed.sample(env, (), env_ids)
        sideways = torch.stack((change * angle.cos(), change * angle.sin()), dim=1)
        velocity = thing.root_velocity[env_ids]
        thing.set_root_velocity(torch.cat((velocity[:, :2] + sideways, velocity[:, 2:]), dim=1), env_ids)

    return event


def by_success(raised: float = 0.05, lowered: float = 0.02) -> TermFunction:
    """A curriculum's change: the next episode is harder by ``raised`` after a success, else easier by ``lowered``."""

    def change(env: Environment) -> Tensor:
        return torch.where(env.task.success(env), raised, -lowered)

    return change


def _check_tilt(tilt: float, term: str) -> None:
    if not 0.0 <= tilt < 0.5 * math.pi:
        raise ConfigurationError(f"randomize.{term}: tilt must be from 0 to less than pi / 2 rad, not {tilt}")


def _tilted(env: Environment, directions: Tensor, tilt: float, env_ids: Tensor) -> Tensor:
    """Return unit vectors (n or 1, K, 3), turned by up to ``tilt`` radians any way, each environment by its draw."""
    count, random = directions.shape[1], env.world.random
    # Uniform over a disc, so that small turns are as likely as large ones for their share of directions.
    radius = math.tan(tilt) * random.uniform((count, 1), env_ids=env_ids).sqrt()
    angle = random.uniform((count, 1), -torch.pi, torch.pi, env_ids)
    least = torch.nn.functional.one_hot(directions.abs().argmin(-1), 3).to(directions.dtype)
    first = torch.nn.functional.normalize(torch.linalg.cross(directions, least), dim=-1)
    second = torch.linalg.cross(directions, first)
    turned = directions + radius * (angle.cos() * first + angle.sin() * second)
    return torch.nn.functional.normalize(turned, dim=-1)


def _camera(world: World, name: str) -> CameraSensor:
    sensor = world.sensors.get(name)
    if not isinstance(sensor, CameraSensor):
        cameras = [each for each, one in world.sensors.items() if isinstance(one, CameraSensor)]
        raise UnknownNameError("camera", name, cameras, "the scene")
    return sensor


def _entity(world: World, name: str) -> Object:
    thing = world.robots.get(name) or world.objects.get(name)
    if thing is None:
        raise UnknownNameError("entity", name, [*world.robots, *world.objects], "the scene")
    return thing
