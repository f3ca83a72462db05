"""Settings of a run of the suite, with every name checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from orbit_assets.catalogue import robot_info, robot_names
from orbit_assets.sources import installed_version
from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.scenario import Scenario
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.transfer import learned
from orbit_conformance.verdict import lacking
from orbit_core.backends import backend as find_backend
from orbit_core.backends import backend_config, backend_names, matter_names, matter_solver, renderer, renderer_names
from orbit_core.envs.registry import task_entries, task_entry
from orbit_core.installing import install_extra
from orbit_core.interfaces import EXACT, Backend, Capability, ConfigurationError, Gap, Level, UnknownNameError
from orbit_core.interfaces.capabilities import MATTER
from orbit_core.interfaces.matter import NATIVE, MatterSolver
from orbit_learn.pretrained import pretrained_policies

# Check that a backend's declarations can be true, before anything runs ------------------------------------------------


def check_declarations(owner: Backend | MatterSolver) -> None:
    """Reject declared gaps of things that are never measured, and capabilities that gaps contradict.

    A backend's gaps in scenarios of matter concern its native matter; a matter solver's hold on every engine.

    Raises:
        UnknownNameError: a gap names no scenario and no check of robots, no metric of its scenario, or no robot; names
            the nearest.
        ConfigurationError: two gaps are of one metric, or of one of one robot, one has no reason, a limit is no more
            than the tolerance, one of a check names no robot, the owner lacks what a gap's scenario needs, or what that
            scenario measures is declared exact.
    """
    who = f"{'backend' if isinstance(owner, Backend) else 'matter solver'} '{owner.name}'"
    where = f"the gaps of {who}"
    # Gaps name scenarios and checks of robots alike.
    experiments = {experiment.name: experiment for experiment in (*SCENARIOS, *CHECKS)}
    seen: set[tuple[str, str, str]] = set()
    for gap in owner.gaps():
        if gap.scenario not in experiments:
            raise UnknownNameError("scenario", gap.scenario, experiments, where)
        experiment = experiments[gap.scenario]
        metrics = {metric.name: metric for metric in experiment.metrics}
        if gap.metric not in metrics:
            raise UnknownNameError("metric", gap.metric, metrics, f"{where}, scenario '{gap.scenario}'")
        of = {(gap.scenario, gap.metric, robot) for robot in gap.robots or ("",)}
        if of & seen:
            raise ConfigurationError(f"{where} name metric '{gap.metric}' of '{gap.scenario}' twice: keep one")
        seen |= of
        _check_limit(gap, metrics[gap.metric].tolerance, where)
        if not isinstance(experiment, Scenario):
            _check_robots(gap, where)
            continue
        if gap.robots:
            raise ConfigurationError(f"{where} name robots for '{gap.scenario}', which has none of the catalogue's")
        if reason := _not_run(owner, experiment):
            raise ConfigurationError(f"{where} name scenario '{gap.scenario}', which does not run on it: {reason}")
        for capability in experiment.judges:
            if owner.capabilities()[capability].level is Level.EXACT:
                raise ConfigurationError(
                    f"{who} declares '{capability.value}' exact, and metric '{gap.metric}' of '{gap.scenario}', which "
                    "measures that, a gap: declare it approximate, with how it differs"
                )


def _not_run(owner: Backend | MatterSolver, experiment: Scenario) -> str:
    """Return the reason for which the owner of a gap does not run its scenario; empty if it does."""
    if isinstance(owner, Backend):
        return lacking(owner, experiment)
    if not experiment.of_matter:
        return "it has no matter"
    return "; ".join(n.value for n in experiment.needs if n in MATTER and not owner.capabilities().has(n))


def _check_robots(gap: Gap, where: str) -> None:
    if not gap.robots:
        raise ConfigurationError(f"{where} name '{gap.scenario}', a check of robots, and no robot: say of which")
    for robot in gap.robots:
        robot_info(robot)


def _check_limit(gap: Gap, tolerance: float, where: str) -> None:
    what = f"{where}, metric '{gap.metric}' of '{gap.scenario}':"
    if not gap.limit > tolerance:
        raise ConfigurationError(f"{what} the limit must be above the tolerance of {tolerance:g}, not {gap.limit:g}")
    if not gap.reason.strip():
        raise ConfigurationError(f"{what} a gap needs a reason")


class Part(Enum):
    """A part of the suite."""

    SCENARIOS = "scenarios"
    """Scenarios of physics with known answers."""
    ROBOTS = "robots"
    """Every robot of the catalogue, put to the checks that apply to it."""
    TASKS = "tasks"
    """Every task with its scripted expert: success rate, divergence, replays, videos."""
    TRANSFERS = "transfers"
    """Every kept policy on every backend, whichever it was learned on."""
    THROUGHPUT = "throughput"
    """Speed of every task over numbers of environments."""


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Number of episodes and steps that are spent on each task."""

    episodes: int
    """Number of episodes, one in each environment."""
    slow_episodes: int
    """The same of slow tasks, :meth:`Settings.is_slow`; where there is but one, and it misses, two."""
    slow_replays: bool
    """Whether the actions of slow tasks are taken again on other backends too."""
    pixel_episodes: int
    """The same of policies that see pictures, which most engines here draw on the CPU, a few a second; 0 leaves these
    policies out."""
    throughput_envs: tuple[int, ...]
    """Numbers of environments of a measurement of throughput on a CPU."""
    gpu_throughput_envs: tuple[int, ...]
    """The same on a GPU; none of a CPU's, so that results of both can be merged."""
    blocks: int
    """Number of blocks of the environment's steps and of the raw engine's, which alternate."""
    block_steps: int
    """Steps of a block."""
    video_seconds: float
    """Longest duration of a video; an episode may last longer."""


QUICK = Extent(
    episodes=4,
    slow_episodes=1,
    slow_replays=False,
    pixel_episodes=0,
    throughput_envs=(8,),
    gpu_throughput_envs=(1024,),
    blocks=3,
    block_steps=10,
    video_seconds=0.5,
)
FULL = Extent(
    episodes=50,
    slow_episodes=50,
    slow_replays=True,
    pixel_episodes=4,
    throughput_envs=(1, 16, 64),
    # A GPU's rate grows up to some ten thousand environments, which a CPU would need minutes to step once.
    gpu_throughput_envs=(1024, 4096, 16384),
    blocks=5,
    block_steps=20,
    video_seconds=5.0,
)


# Seconds from which on an episode is long.
LONG = 10.0

# One without a hand, an arm, a hand of many followers, and one that stands.
QUICK_ROBOTS = ("cartpole", "franka_panda", "robotiq_2f85", "unitree_go1")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a run; two runs of equal settings and versions are the same run."""

    backends: tuple[str, ...]
    """Names of the backends."""
    scenarios: tuple[str, ...]
    """Names in the order of ``SCENARIOS``; empty if that part is left out."""
    tasks: tuple[str, ...]
    """Tasks of all parts but ``SCENARIOS`` and ``ROBOTS``."""
    parts: tuple[Part, ...]
    """Parts of the suite that are run."""
    robots: tuple[str, ...] = ()
    """Robots of the part ``ROBOTS``; empty if that is left out."""
    policies: tuple[str, ...] = ()
    """Of the part ``TRANSFERS``: those that are kept for the tasks."""
    renderers: tuple[str, ...] = ()
    """Of the part ``TRANSFERS``: those that draw for policies that see pictures, in addition to the backends' own."""
    matters: tuple[str, ...] = (NATIVE,)
    """Who simulates what bends or flows in scenarios that have some: matter solvers, and the engines themselves."""
    quick: bool = False
    """The nominal time steps of the quick scenarios and of those that are named; few episodes, few environments, and of
    the first task alone a video."""
    episodes: int | None = None
    """The most episodes of a task or a policy, if these are to be fewer than ``quick`` or the full run has."""
    device: str = "cpu"
    """Torch device of the backends that simulate on a GPU; the others take the CPU."""
    seed: int = 0
    """Seed of the random streams."""
    backend_settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Settings of backends that differ from their defaults, by backend and field name."""

    @property
    def scripted_tasks(self) -> tuple[str, ...]:
        """Tasks that have an expert; the others are learned, and tried by the policies that are kept for them."""
        return tuple(name for name in self.tasks if task_entry(name).task_type().has_expert())

    @property
    def extent(self) -> Extent:
        """Extent of each task. Where episodes are few, slow tasks are not replayed either."""
        whole = QUICK if self.quick else FULL
        if self.episodes is None:
            return whole
        names = ("episodes", "slow_episodes", "pixel_episodes")
        fewer = {name: min(self.episodes, getattr(whole, name)) for name in names}
        return replace(whole, slow_replays=whole.slow_replays and fewer["episodes"] == whole.episodes, **fewer)

    def is_slow(self, task: str) -> bool:
        """Return True if the task has long episodes, or cloth or rope, which a CPU steps slowly."""
        defaults: dict[str, Any] = {}
        own = task_entry(task).task_type()(**defaults)
        return own.episode_length >= LONG or bool(own.scene().deformables)

    def settings_of(self, backend: str) -> Mapping[str, Any]:
        """Settings of the backend in the place of its defaults, by field name."""
        return self.backend_settings.get(backend, {})

    def device_of(self, backend: str) -> str:
        """The device on which the backend simulates."""
        return self.device if find_backend(backend).capabilities().has(Capability.GPU) else "cpu"

    def throughput_envs_of(self, backend: str) -> tuple[int, ...]:
        """Numbers of environments of the backend's measurements of throughput, as many as its device is made for."""
        extent = self.extent
        return extent.throughput_envs if self.device_of(backend) == "cpu" else extent.gpu_throughput_envs


def choose(
    *,
    backends: Sequence[str] = (),
    scenarios: Sequence[str] = (),
    tasks: Sequence[str] = (),
    robots: Sequence[str] = (),
    parts: Sequence[str] = (),
    matters: Sequence[str] = (),
    quick: bool = False,
    episodes: int | None = None,
    device: str = "cpu",
    seed: int = 0,
    backend_settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Settings:
    """Settings from names; none given means all of that kind.

    Without ``parts``, naming scenarios, robots or tasks leaves the parts of the others out. A robot may be named by its
    parts, as ``"ur10+robotiq_2f85"``. ``"native"`` in ``matters`` means the engines' own.

    Raises:
        UnknownNameError: a name is unknown, or one that a declared gap has; names the nearest.
        ConfigurationError: no backend is installed; a declared gap, or a backend's setting, can not be.
    """
    installed = backend_names()
    if not installed:
        raise ConfigurationError(f"no backend is installed: {install_extra('BACKEND')}, see 'orbit list backends'")
    known = [s.name for s in SCENARIOS]
    # A slow scenario that is named runs in a quick run too.
    tried = [s.name for s in SCENARIOS if not (quick and s.slow)]
    of_tasks = (Part.TASKS, Part.TRANSFERS, Part.THROUGHPUT)
    named = {Part.SCENARIOS: scenarios, Part.ROBOTS: robots} | dict.fromkeys(of_tasks, tasks)
    implied = tuple(part for part in Part if named[part] or not (scenarios or robots or tasks))
    chosen = tuple(Part(name) for name in _known("part", parts, [part.value for part in Part])) if parts else implied
    backends = _known("backend", backends, installed)
    # Declarations that cannot be true would only show after hours of a full run.
    for name in backends:
        check_declarations(find_backend(name))
    matters = _known("matter solver", matters, (*matter_names(), NATIVE))
    for name in matters:
        if name != NATIVE:
            check_declarations(matter_solver(name))
    for name, values in (backend_settings or {}).items():
        backend_config(find_backend(*_known("backend", (name,), backends)), values)
    policies = _policies(tasks, QUICK if quick else FULL) if Part.TRANSFERS in chosen else ()
    return Settings(
        backends=backends,
        scenarios=_known("scenario", scenarios or tried, known) if Part.SCENARIOS in chosen else (),
        tasks=_known("task", tasks, task_entries()) if {*of_tasks} & {*chosen} else (),
        parts=chosen,
        robots=_robots(robots, quick) if Part.ROBOTS in chosen else (),
        policies=policies,
        matters=matters,
        renderers=_renderers() if any(learned(name).sees_pictures for name in policies) else (),
        quick=quick,
        episodes=episodes,
        device=device,
        seed=seed,
        backend_settings=backend_settings or {},
    )


def _robots(named: Sequence[str], quick: bool) -> tuple[str, ...]:
    """Return the named robots, or else all of the catalogue whose models are installed."""
    for name in named:
        robot_info(name)
    known = QUICK_ROBOTS if quick else robot_names()
    return tuple(dict.fromkeys(named)) or tuple(name for name in known if _is_installed(name))


def _is_installed(name: str) -> bool:
    source = robot_info(name).source
    return all(installed_version(package) is not None for package in source.split(", ") if package)


def _policies(tasks: Sequence[str], extent: Extent) -> tuple[str, ...]:
    """The policies learned for the tasks, all if none is named; those that see pictures need pixel episodes."""
    named = (name for name in pretrained_policies() if not tasks or learned(name).task in tasks)
    return tuple(name for name in named if extent.pixel_episodes or not learned(name).sees_pictures)


def _renderers() -> tuple[str, ...]:
    """The installed backends that draw, and the renderers that simulate nothing, but for those that trace paths: these
    take longer for an episode's pictures than a job may.
    """
    drawing = [name for name in backend_names() if find_backend(name).capabilities().has(Capability.RGB)]
    # A path tracer takes minutes for an episode's pictures.
    alone = [name for name in renderer_names() if renderer(name).capabilities()[Capability.RAY_TRACED_RGB] != EXACT]
    return (*drawing, *alone)


def scenario(name: str) -> Scenario:
    """The scenario of that name.

    Raises:
        UnknownNameError: there is none.
    """
    _known("scenario", (name,), [s.name for s in SCENARIOS])
    return next(s for s in SCENARIOS if s.name == name)


def _known(kind: str, names: Sequence[str], known: Iterable[str]) -> tuple[str, ...]:
    """Return the known names that are given, in the order of the known; all if none is given."""
    known = tuple(known)
    for name in names:
        if name not in known:
            raise UnknownNameError(kind, name, known)
    return tuple(name for name in known if name in names or not names)
