"""Manifest: the environment that made a dataset, a policy or an export, as typed data that describes itself."""

from __future__ import annotations

import dataclasses
import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from orbit_core.actions.term import ActionTerm
from orbit_core.backends import renderer_names, versions_of
from orbit_core.envs.observation_layout import groups_of, terms_of_group
from orbit_core.envs.terms import POSE, ObservationGroup, ObservationTerm, meaning_of, unit_of
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.layout import actuator_of_joint, joint_limits
from orbit_data.manifest.plain import ROUNDED, as_plain, digest
from orbit_data.reading.budget import MAX_DOCUMENT

if TYPE_CHECKING:
    from orbit_core.actions import MotionGenerator
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.observation_layout import GroupLayout, TermLayout
    from orbit_core.interfaces import Object, Robot
    from orbit_core.scene import Scene


FORMAT = 1
"""Version of the manifest; another is refused."""
# Shortest plausible time in seconds, and the reciprocal of the longest.
_LEAST = 1e-9
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
Limits = tuple[float | None, ...]
"""Numbers, with None instead of infinity, because JSON has no infinity."""


@dataclass(frozen=True)
class RobotManifest:
    """Robot of the scene; all lists are in the order of its joints."""

    model: str
    """Name of the robot's articulation."""
    joint_names: tuple[str, ...]
    """Names of the movable joints."""
    home_positions: tuple[float, ...]
    """Default positions in rad or m."""
    lower_limits: Limits
    """rad or m"""
    upper_limits: Limits
    """rad or m"""
    velocity_limits: Limits
    """rad/s or m/s"""
    effort_limits: Limits
    """N m or N"""
    stiffness: tuple[float, ...]
    """Stiffness of the joint's actuator in N m/rad or N/m; 0 if it has none."""
    damping: tuple[float, ...]
    """N m s/rad or N s/m"""
    actuators: tuple[str, ...]
    """Type of each joint's actuator; empty if it has none."""
    agent: bool
    """Whether the robot acts in the task."""


@dataclass(frozen=True)
class ObservationTermManifest:
    """Term of an observation group, as the policy sees it."""

    shape: tuple[int, ...]
    """Shape of one environment's value, including the history."""
    dtype: str
    """Name of the dtype in torch."""
    unit: str
    """Unit before ``scale``; empty if the task does not state it."""
    scale: float
    """Factor of the measured value."""
    history: int
    """Number of steps that are seen, the oldest first."""
    low: float | None
    """Least value; None if unbounded."""
    high: float | None
    """Greatest value; None if unbounded."""
    formula: str = ""
    """Quantity in a sentence; the policy sees ``scale * (measured - offset)``."""
    frame: str = ""
    """Frame that the term is expressed in; empty if it has none (joints), or the task does not state it."""
    components: tuple[str, ...] = ()
    """Names of the numbers of one step, in order; empty for pictures, whose order is row, column, channel."""
    offset: tuple[float, ...] = ()
    """Offset that is subtracted from each of these numbers as it is measured, in ``unit``."""
    order: str = ""
    """Order of the numbers if several steps are seen."""


@dataclass(frozen=True)
class GroupManifest:
    """Observation group: its terms by name, in order."""

    concatenated: bool
    """Whether the terms are concatenated in one vector, or separate in a dictionary."""
    terms: dict[str, ObservationTermManifest]
    """Terms by name."""


@dataclass(frozen=True)
class ActionTermManifest:
    """Part of the action; its components are in [-1, 1]."""

    generator: str
    """Name of the motion generator."""
    robot: str
    """Name of the robot that the term moves."""
    joints: tuple[str, ...]
    """Joints that the term moves."""
    components: tuple[str, ...]
    """Names of the components."""
    offset: tuple[float, ...] | None
    """Offset in rad or m if joint targets are ``offset + scale * command``; None if they are not."""
    scale: tuple[float, ...] | None
    """rad or m for a command of 1, as in ``offset``; None if targets are not linear in commands."""
    lower_limits: Limits
    """Least position of each joint that a command can request, in rad or m."""
    upper_limits: Limits
    """Greatest position that a command can request, in rad or m."""
    settings: dict[str, Any]
    """All fields of the term's configuration."""
    decoding: str = ""
    """Effect of a command, with formulas that use the names in ``settings``."""
    frame: str = ""
    """Frame that the components are expressed in."""
    leads: Limits = ()
    """Limit in rad or m of each target's lead over the measured position; empty or None: unlimited."""
    clip: tuple[float, float] = (-1.0, 1.0)
    """Bounds that each component is clipped to before it is decoded."""
    rate: float = 0.0
    """Rate in Hz at which commands are applied."""


_Term = TypeVar("_Term", ObservationTermManifest, ActionTermManifest)


@dataclass(frozen=True)
class Manifest:
    """Description of an environment that is sufficient to use its data and policies, and to make it again."""

    task: str
    """Name of the task, for :func:`orbit_core.envs.make`."""
    configuration: dict[str, Any]
    """The task's fields, as :func:`~orbit_data.manifest.plain.as_plain` writes them."""
    robots: dict[str, RobotManifest]
    """Robots of the scene by name."""
    observations: dict[str, GroupManifest]
    """Observation groups by name."""
    action_terms: dict[str, ActionTermManifest]
    """Action terms, in the order of the action's components."""
    step_dt: float
    """Seconds between two actions."""
    physics_dt: float
    """Seconds of a physics step."""
    decimation: int
    """Physics steps between two actions."""
    episode_length: float
    """Seconds until the time limit."""
    gravity: tuple[float, float, float]
    """m/s^2, in the environment's frame."""
    backend: str
    """Name of the backend."""
    settings: dict[str, Any]
    """Settings of the backend."""
    matter: str
    """Matter solver; empty if there is none."""
    versions: dict[str, str]
    """Versions of the distributions that took part, by name."""
    device: str
    """Torch device of the environment."""
    num_envs: int
    """Number N of environments."""
    seed: int
    """Seed of the world's random streams."""
    assets: dict[str, str]
    """Digests of all simulated entities by name, over links, masses, shapes, joints and meshes."""
    input_device: str = ""
    """Device that a person used; empty if no person acted."""
    made_later: str = ""
    """Date and source of a manifest that was made later, for data that is older than manifests."""
    noise: float | None = None
    """Standard deviation of the noise on executed actions, in their units; None if unknown, or not one for all."""
    stray: float | None = None
    """The same, of noise at the start of episodes only."""
    format: int = field(default=FORMAT)
    """Version of the manifest's own layout; other versions are not read."""

    @staticmethod
    def of(environment: Environment, task: str, seed: int) -> Manifest:
        """Return the manifest of an environment.

        Args:
            environment: environment that makes the data.
            task: name that the environment was made by.
            seed: seed of its random streams.
        """
        own, world = environment.task, environment.world
        scene, groups = world.scene, groups_of(own)
        configuration = as_plain(own)
        terms = zip(environment.actions.terms.items(), environment.actions.generators, strict=True)
        # Backends that only draw, and worlds without settings, simulate nothing, so no engine belongs to the data.
        simulated = not (world.backend in renderer_names() or world.settings is None)
        return Manifest(
            task=task,
            configuration=configuration,
            robots={name: _robot(robot, name in own.agents) for name, robot in world.robots.items()},
            observations={n: _group(environment, groups[n], layout) for n, layout in environment.observation.items()},
            action_terms={
                name: _action(name, term, generator, environment.step_dt) for (name, term), generator in terms
            },
            step_dt=environment.step_dt,
            physics_dt=own.physics_dt,
            decimation=own.decimation,
            episode_length=own.episode_length,
            gravity=scene.gravity,
            backend=world.backend,
            settings={} if world.settings is None else as_plain(world.settings),
            matter=world.matter,
            versions=versions_of(world.backend if simulated else None, matter=world.matter),
            device=str(environment.device),
            num_envs=environment.num_envs,
            seed=seed,
            assets=_assets(scene),
        )

    @property
    def explains(self) -> bool:
        """True if every term describes its numbers, which the first manifests did not."""
        seen = [term for group in self.observations.values() for term in group.terms.values()]
        return all(term.formula for term in seen) and all(term.decoding for term in self.action_terms.values())

    def explained_by(self, present: Manifest) -> Manifest:
        """Return the manifest with missing descriptions of its terms taken from another one of the same terms."""
        groups = {
            name: dataclasses.replace(
                group,
                terms={n: _explained(term, present.observations[name].terms[n]) for n, term in group.terms.items()},
            )
            for name, group in self.observations.items()
        }
        actions = {name: _explained(term, present.action_terms[name]) for name, term in self.action_terms.items()}
        return dataclasses.replace(self, observations=groups, action_terms=actions)

    def encode(self) -> bytes:
        """Return the manifest as JSON."""
        return msgspec.json.encode(self)

    def document(self) -> dict[str, Any]:
        """Return the manifest as plain data."""
        return msgspec.to_builtins(self)

    @staticmethod
    def decode(data: bytes | str | Mapping[str, Any], where: str) -> Manifest:
        """Read a manifest from the result of :meth:`encode` or :meth:`document`.

        Args:
            data: JSON or plain data.
            where: name of the file for messages.

        Raises:
            ConfigurationError: the data is not a manifest, or of another format; the message names the place.
        """
        try:
            if isinstance(data, str | bytes) and len(data) > MAX_DOCUMENT:
                raise ConfigurationError(f"{where} holds no manifest: it would have {len(data):,} bytes")
            values = msgspec.json.decode(data) if isinstance(data, str | bytes) else data
            if not isinstance(values, Mapping) or values.get("format") != FORMAT:
                found = values.get("format") if isinstance(values, Mapping) else None
                raise ConfigurationError(
                    f"{where} holds a manifest of format {found!r:.40}, and {FORMAT} is the one that is read: make it "
                    "again, or read it with the version of ORBIT that wrote it"
                )
            manifest = msgspec.convert(values, Manifest)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise ConfigurationError(f"{where} holds no manifest: {error}") from None
        # These are divided by, or multiplied into counts of steps.
        for name in ("step_dt", "physics_dt", "decimation", "episode_length"):
            if not _LEAST <= getattr(manifest, name) <= 1.0 / _LEAST:
                raise ConfigurationError(f"{where} holds no manifest: its {name} is not from {_LEAST} to {1 / _LEAST}")
        return manifest


def _assets(scene: Scene) -> dict[str, str]:
    """Compute digests by name, without a reader's notes, which depend on where the files are."""
    bodies = {e.name: [dataclasses.replace(a, notes=()) for a in e.alternatives] for e in scene.entities}
    return {name: digest(body) for name, body in {**bodies, **{d.name: d for d in scene.deformables}}.items()}


def _robot(robot: Robot | Object, agent: bool) -> RobotManifest:
    spec = robot.spec
    actuators = actuator_of_joint(spec)
    driven = [actuators.get(joint) for joint in range(len(robot.joint_names))]
    lower, upper = robot.position_limits.cpu().unbind(-1)
    return RobotManifest(
        model=spec.articulation.name,
        joint_names=robot.joint_names,
        home_positions=tuple(robot.home_positions.tolist()),
        lower_limits=_limits(lower.tolist()),
        upper_limits=_limits(upper.tolist()),
        velocity_limits=_limits(joint_limits(spec, "velocity_limit").tolist()),
        effort_limits=_limits(joint_limits(spec, "effort_limit").tolist()),
        stiffness=tuple(float(group.stiffness) if group else 0.0 for group in driven),
        damping=tuple(float(group.damping) if group else 0.0 for group in driven),
        actuators=tuple(type(group).__name__ if group else "" for group in driven),
        agent=agent,
    )


def _group(environment: Environment, group: ObservationGroup, layout: GroupLayout) -> GroupManifest:
    terms = terms_of_group(group)
    return GroupManifest(
        concatenated=layout.concatenated,
        terms={name: _term(environment, group, terms[name], shown) for name, shown in layout.terms.items()},
    )


def _term(
    environment: Environment, group: ObservationGroup, term: ObservationTerm, shown: TermLayout
) -> ObservationTermManifest:
    history = group.history if term.history is None else term.history
    meaning, size = meaning_of(term), math.prod(shown.shape) // history
    given = (environment, *(() if term.agent is None else (term.agent,)))
    # A picture has three dimensions, and one more for its history unless the group joins that with the channels.
    picture = len(shown.shape) - (history > 1 and not group.concatenate) >= 3
    components = meaning.components(*given) if callable(meaning.components) else meaning.components
    offset = [0.0] * size if meaning.offset is None else meaning.offset(*given).flatten().tolist()
    return ObservationTermManifest(
        shape=tuple(shown.shape),
        dtype=str(shown.dtype).removeprefix("torch."),
        unit=unit_of(term),
        scale=term.scale,
        history=history,
        low=_limit(shown.low),
        high=_limit(shown.high),
        formula=meaning.formula,
        frame=meaning.frame,
        components=() if picture else tuple(components) or _named(size, unit_of(term)),
        offset=() if picture else tuple(offset),
        order="oldest step first, the numbers of a step together" if history > 1 else "",
    )


def _named(size: int, unit: str) -> tuple[str, ...]:
    """Return names for numbers that the task does not name: those of a pose or a vector, otherwise indices."""
    # Poses before vectors: the first match counts.
    for names, units in ((_POSE, (POSE,)), (_POSE[:3], ("m", "m/s", "rad/s", "m/s^2", "N"))):
        if unit in units and size % len(names) == 0:
            several = size > len(names)
            return tuple(f"{row} {n}" if several else n for row in range(size // len(names)) for n in names)
    return tuple(map(str, range(size)))


def _action(name: str, term: ActionTerm, generator: MotionGenerator, step_dt: float) -> ActionTermManifest:
    spec = generator.robot.spec
    offset, scale = generator.affine or (None, None)
    lower, upper = generator.position_range.cpu().unbind(1)
    return ActionTermManifest(
        generator=term.name,
        robot=term.robot,
        joints=tuple(generator.robot.joint_names[joint] for joint in generator.joints),
        components=term.components(spec, name),
        offset=None if offset is None else tuple(offset.tolist()),
        scale=None if scale is None else tuple(scale.tolist()),
        lower_limits=_limits(lower.tolist()),
        upper_limits=_limits(upper.tolist()),
        settings={field.name: as_plain(getattr(term, field.name)) for field in dataclasses.fields(term)},
        decoding=_decoding(type(term)),
        frame=term.reference,
        leads=() if generator.lead is None else _limits(generator.lead.tolist()),
        rate=1.0 / step_dt,
    )


def _decoding(kind: type[ActionTerm]) -> str:
    """Return the docstrings of an action term's classes, which describe its command."""
    own = [base for base in kind.__mro__[: kind.__mro__.index(ActionTerm)] if base.__doc__]
    return " ".join(" ".join(base.__doc__.split()) for base in own if base.__doc__)


def _explained(term: _Term, present: _Term) -> _Term:
    """Return a term with its empty fields, which were added to the format later, taken from another term."""
    own = {field.name: getattr(term, field.name) for field in dataclasses.fields(term)}
    missing = {name: getattr(present, name) for name, value in own.items() if value in ("", (), 0.0)}
    return dataclasses.replace(term, **missing)


def _limits(values: Sequence[float]) -> Limits:
    return tuple(_limit(value) for value in values)


def _limit(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# Comparison of an environment with the one of data or a policy: every difference by its path, and its severity.

# Relative difference of numbers that counts as none: that of single precision.
_CLOSE = 1e-6


class Kind(Enum):
    """Severity of a difference."""

    ERROR = "error"
    """Numbers have another meaning: another order of joints, other terms, scales or rates."""
    WARNING = "warning"
    """The same numbers have other effects: other gains, limits, masses, gravity, matter."""
    NOTE = "note"
    """Another origin: the engine, versions, seeds, rewards and events of the task."""


# Patterns of paths, of which the first match counts.
_RULES: tuple[tuple[str, Kind], ...] = (
    (r"(action_terms|observations)(\..*)?\.(low|high)", Kind.WARNING),
    (r"(action_terms|observations)\..*\.(formula|frame|order|decoding|rate|clip|leads)", Kind.NOTE),
    (r"action_terms(\..*)?|observations(\..*)?|step_dt", Kind.ERROR),
    (r"robots\.[^.]*|robots\..*\.(joint_names|agent)", Kind.ERROR),
    (r"robots\..*|assets(\..*)?|gravity|physics_dt|decimation|matter|task", Kind.WARNING),
    (r".*", Kind.NOTE),
)


@dataclass(frozen=True)
class Difference:
    """Difference of one value."""

    kind: Kind
    """Severity, by the rule for the path."""
    path: str
    """Path within the manifest."""
    recorded: Any
    """Value in the manifest; None if it has none."""
    present: Any
    """Value of the environment; None if it has none."""

    def __str__(self) -> str:
        return f"{self.path} was {_shown(self.recorded)} and is {_shown(self.present)}"


def differences(recorded: Manifest, present: Manifest, groups: Collection[str] | None = None) -> list[Difference]:
    """Return all differences, the most severe first.

    Args:
        recorded: manifest of the data or policy.
        present: manifest of the environment.
        groups: observation groups that matter; all if None.
    """
    old, new = (_reduced(manifest.document(), groups) for manifest in (recorded, present))
    for name, group in old["observations"].items():
        if not group["concatenated"] and (other := new["observations"].get(name)):
            # A reader of a dictionary takes the terms that it knows, so that additional ones are no difference.
            other["terms"] = {term: other["terms"][term] for term in group["terms"] if term in other["terms"]}
    return sorted(_differences(old, new, ""), key=lambda difference: [*Kind].index(difference.kind))


def check_manifest(
    recorded: Manifest, environment: Environment, what: str, groups: Collection[str] | None = None
) -> list[Difference]:
    """Compare an environment with a manifest, warn of other effects, and return all differences.

    Args:
        recorded: manifest of the data or policy.
        environment: environment in which it will be used.
        what: the data or policy, for messages.
        groups: observation groups that matter; all if None.

    Raises:
        ConfigurationError: numbers would have another meaning; the message names every such difference.
    """
    found = differences(recorded, Manifest.of(environment, recorded.task, recorded.seed), groups)
    errors = [str(difference) for difference in found if difference.kind is Kind.ERROR]
    if errors:
        raise ConfigurationError(f"{what} does not fit this environment: {'; '.join(errors)}")
    graver = [str(difference) for difference in found if difference.kind is Kind.WARNING]
    if graver:
        warnings.warn(f"{what} was made with other settings: {'; '.join(graver)}", stacklevel=2)
    return found


def renamed_group(manifest: Manifest, name: str, other: str) -> Manifest:
    """Return a manifest with an observation group renamed, for environments with the same terms in another group."""
    groups = {other if group == name else group: terms for group, terms in manifest.observations.items()}
    return replace(manifest, observations=groups)


def _reduced(document: dict[str, Any], groups: Collection[str] | None) -> dict[str, Any]:
    if groups is not None:
        document["observations"] = {n: group for n, group in document["observations"].items() if n in groups}
    return document


def _differences(old: Any, new: Any, path: str) -> Iterator[Difference]:
    """Yield the differences below a path; lists, the order of terms and values of one side count as one difference."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        if not _same(old, new):
            yield Difference(_kind(path) if _comparable(path, old, new) else Kind.NOTE, path, old, new)
        return
    ordered = path == "action_terms" or path.endswith(".terms")
    if ordered and old.keys() == new.keys() and [*old] != [*new]:
        yield Difference(_kind(path), f"{path}, in order,", ", ".join(old), ", ".join(new))
    for key in dict.fromkeys((*old, *new)):
        yield from _differences(old.get(key), new.get(key), f"{path}.{key}" if path else key)


def _same(old: Any, new: Any) -> bool:
    if isinstance(old, list | tuple) and isinstance(new, list | tuple):
        return len(old) == len(new) and all(map(_same, old, new))
    if isinstance(old, float) and isinstance(new, int | float):
        return math.isclose(old, new, rel_tol=_CLOSE, abs_tol=_CLOSE)
    return old == new


def _comparable(path: str, old: Any, new: Any) -> bool:
    """Return whether two values can be compared: not fields that old manifests lack, nor digests of different kinds."""
    if re.fullmatch(r"observations\..*\.(components|offset)", path) and not old:
        return False
    # Old digests are of every bit, new ones (ROUNDED) of nine significant digits: they differ for equal assets.
    digests = path.startswith("assets.") and isinstance(old, str) and isinstance(new, str)
    return not digests or old.startswith(ROUNDED) == new.startswith(ROUNDED)


def _kind(path: str) -> Kind:
    return next(kind for pattern, kind in _RULES if re.fullmatch(pattern, path))


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "there"
    if isinstance(value, list | tuple):
        value = ", ".join(_shown(item) for item in value)
    text = f"{value:g}" if isinstance(value, float) else "absent" if value is None else str(value)
    return text if len(text) <= 120 else f"{text[:117]}..."
