"""ORBIT's tasks as environments of LeRobot, registered as ``--env.type=orbit``.

LeRobot imports this module where the distribution ``lerobot_env_orbit`` is installed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import EnvironmentSettings, read_file
from orbit_core.interfaces.errors import ConfigurationError
from orbit_learn.lerobot_env import JOINTS, PICTURES, STATE_OF_SCENE, LeRobotEnvironment


@EnvConfig.register_subclass("orbit")
@dataclass
class OrbitEnv(EnvConfig):
    """A task of ORBIT, or several with a comma between them, which show and take the same."""

    task: str | None = "Lift"
    backend: str | None = None
    """Physics backend ('orbit list backends'); may be left out if only one is installed."""
    robot: str | None = None
    """Robot of the catalogue in the place of the task's own."""
    action: str | None = None
    """Action space in the place of the task's own."""
    renderer: str | None = None
    """Renderer ('orbit list renderers'); the physics backend if left out."""
    device: str = "cpu"
    """Torch device of the simulation."""
    cameras: list[str] = field(default_factory=list)
    """Cameras that the policy sees in place of the state that they show, such as front:84x84."""
    set: list[str] = field(default_factory=list)
    """Fields of the task, such as tolerance=0.03."""
    config: str | None = None
    """TOML file with these keys, as 'orbit record --config' takes it."""
    instruction: str | None = None
    """The task in words; the task's own if left out."""
    scene_state: bool = True
    """Show numbers other than those of joints, which policies of pictures do without."""

    def __post_init__(self) -> None:
        # Policies are made from these features before any environment is.
        names = self._names()
        first, *others = (_spaces(each, self.scene_state) for each in self._settings())
        for name, each in zip(names[1:], others, strict=True):
            if each != first:
                raise ConfigurationError(
                    f"tasks that are evaluated together show and take the same: {name} has {each.shown} and actions "
                    f"{each.action}, {names[0]} has {first.shown} and {first.action}; evaluate them one by one, or add "
                    "--env.scene_state=false"
                )
        self.fps = first.fps
        self.features = {ACTION: PolicyFeature(FeatureType.ACTION, first.action)}
        self.features_map = {ACTION: ACTION}
        for key, shape in first.shown.items():
            kind, column = _COLUMNS.get(key, (FeatureType.VISUAL, f"{OBS_IMAGES}.{key.removeprefix(f'{PICTURES}/')}"))
            self.features[key], self.features_map[key] = PolicyFeature(kind, shape), column

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Nothing: environments are made by :meth:`create_envs`."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, LeRobotEnvironment]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Make an environment for each task, by its number; one engine steps all ``n_envs`` of it.

        Args:
            n_envs: environments of a task.
            use_async_envs: not used: one process steps all.
        """
        return {
            "orbit": {
                number: LeRobotEnvironment(
                    make_environment(each, n_envs, reset_diverged=True), name, self.instruction, self.scene_state
                )
                for number, (name, each) in enumerate(zip(self._names(), self._settings(), strict=True))
            }
        }

    def _names(self) -> list[str]:
        names = [name.strip() for name in (self.task or "").split(",") if name.strip()]
        if not names:
            raise ConfigurationError("name a task: --env.task=Lift ('orbit list tasks')")
        return names

    def _settings(self) -> list[EnvironmentSettings]:
        """Return the settings of each task's environment."""
        base = EnvironmentSettings() if self.config is None else read_file(EnvironmentSettings, Path(self.config))
        own = {name: getattr(self, name) for name in ("backend", "robot", "action", "renderer")}
        given = {name: value for name, value in own.items() if value is not None}
        given |= {"device": self.device, "set": tuple(self.set)}
        given |= {"cameras": tuple(self.cameras)} if self.cameras else {}
        values = {name: getattr(base, name) for name in base.__dataclass_fields__}
        return [EnvironmentSettings(**{**values, **given, "task": name}) for name in self._names()]


_COLUMNS = {
    JOINTS: (FeatureType.STATE, OBS_STATE),
    STATE_OF_SCENE: (FeatureType.ENV, OBS_ENV_STATE),
}
"""Type and column of each key of numbers."""


@dataclass(frozen=True)
class _Spaces:
    """Spaces of an environment, before any is kept."""

    shown: dict[str, tuple[int, ...]]
    """Shape of each key; a picture's is ``pixels/<term>``."""
    action: tuple[int, ...]
    fps: int


_known: dict[str, _Spaces] = {}


def _spaces(settings: EnvironmentSettings, scene_state: bool) -> _Spaces:
    """Return the spaces of an environment; it is made once, for LeRobot makes its configuration several times."""
    key = f"{settings!r} {scene_state}"
    if key not in _known:
        made = LeRobotEnvironment(make_environment(settings, 1), settings.task or "", scene_state=scene_state)
        try:
            shown: dict[str, tuple[int, ...]] = {}
            for name, space in made.single_observation_space.spaces.items():
                films = getattr(space, "spaces", {})
                shown |= {f"{name}/{film}": box.shape for film, box in films.items()} or {name: space.shape}
            _known[key] = _Spaces(shown, made.single_action_space.shape, made.metadata["render_fps"])
        finally:
            made.close()
    return _known[key]
