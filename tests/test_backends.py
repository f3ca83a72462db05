"""Plugins are found by entry point, and every way in which that fails says what to do."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import importlib_metadata
import pytest

from orbit_core import backends, installing
from orbit_core.interfaces import (
    CONTRACT,
    EXACT,
    Backend,
    BackendNotInstalledError,
    Capabilities,
    Capability,
    ConfigurationError,
    UnknownNameError,
    UnsupportedCapabilityError,
    unsupported,
)
from orbit_core.registry import PluginWarning
from orbit_core.scene import CameraSpec, Channel, Mesh, ObjectSpec, Scene, Shape, single_link
from orbit_core.scene.shapes import MeshCollision


@dataclass(frozen=True)
class PlainConfig:
    threads: int = 1
    solver: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if self.threads < 0:
            raise ValueError("threads must not be negative")


class PlainBackend(Backend):
    """Everything but triangle meshes."""

    name = "plain"
    contract = CONTRACT
    config_type = PlainConfig

    def capabilities(self) -> Capabilities:
        return Capabilities({Capability.FRICTION: EXACT, Capability.TRIANGLE_MESHES: unsupported("it has hulls only")})

    def create_engine(self, *_: Any) -> Any:
        raise NotImplementedError


class MeshBackend(PlainBackend):
    name = "meshes"

    def capabilities(self) -> Capabilities:
        return Capabilities({Capability.FRICTION: EXACT, Capability.TRIANGLE_MESHES: EXACT})


class Tracer(PlainBackend):
    """Draws depth, and simulates what nobody asks of it."""

    name = "tracer"

    def capabilities(self) -> Capabilities:
        return Capabilities({Capability.DEPTH: EXACT, Capability.TRIANGLE_MESHES: EXACT})


def broken() -> None:
    raise ImportError("libengine.so: cannot open shared object file")


Install = Callable[..., None]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Pretend that exactly these plugins are installed, each ``(name, distribution, factory)``."""

    def forget() -> None:
        for cached in (
            backends._backends,
            backends._renderers,
            backends._matter_solvers,
            backends._kept,
            backends._extras,
        ):
            cached.cache_clear()

    def pretend(
        *plugins: tuple[str, str, Any],
        extras: tuple[str, ...] = (),
        renderers: tuple[tuple[str, str, Any], ...] = (),
        matters: tuple[tuple[str, str, Any], ...] = (),
    ) -> None:
        monkeypatch.setattr(installing, "checkout", lambda: None)
        members = {backends.GROUP: plugins, backends.RENDERERS: renderers, backends.MATTER_SOLVERS: matters}
        groups = {group: [_entry_point(*plugin) for plugin in each] for group, each in members.items()}
        pairs = ((extra, extra.partition("[")[0]) for extra in extras)
        requirements = ["numpy>=1", *(f"orbit-{brought} @ file:///x ; extra == '{extra}'" for brought, extra in pairs)]
        monkeypatch.setattr(importlib_metadata, "entry_points", lambda group: groups[group])
        monkeypatch.setattr(importlib_metadata, "requires", lambda name: requirements)
        monkeypatch.delenv("ORBIT_BACKEND", raising=False)
        forget()

    yield pretend
    monkeypatch.undo()
    forget()


def _entry_point(name: str, distribution: str, made: Any) -> SimpleNamespace:
    requires = ["numpy>=1", "an-engine-that-nobody-has~=2.0 ; extra == 'more'", "pytest ; extra == 'tested'"]
    dist = SimpleNamespace(name=distribution, requires=requires)
    name, _, extra = name.partition(" ")
    extras = [extra] if extra else []
    return SimpleNamespace(name=name, value=f"{name}:Backend", dist=dist, extras=extras, load=lambda: made)


def triangle_scene() -> Scene:
    mesh = Mesh(
        vertices=_array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        faces=_array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], int),
        collision=MeshCollision.TRIANGLES,
    )
    rock = single_link("rock", Shape(mesh), 1.0, [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return Scene(objects=(ObjectSpec(name="rock", articulation=rock, fixed_base=True),))


def _array(values: list[list[int]], kind: type = float) -> Any:
    import numpy as np

    return np.array(values, dtype=kind)


def test_names_are_sorted_and_a_backend_is_made_once(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), ("meshes", "orbit-meshes", MeshBackend))
    assert backends.backend_names() == ["meshes", "plain"]
    assert isinstance(backends.backend("plain"), PlainBackend)
    assert backends.backend("plain") is backends.backend("plain")


def test_an_unknown_name_lists_near_and_known_ones(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), extras=("later",))
    with pytest.raises(UnknownNameError, match=r"unknown backend 'plane'.*did you mean 'plain'.*known: later, plain"):
        backends.backend("plane")


@pytest.mark.parametrize("name", [["cube"], {"name": 1}, None, 3])
def test_a_name_that_is_no_text_is_unknown(name: Any) -> None:
    for find in (backends.backend, backends.renderer, backends.matter_solver):
        with pytest.raises(UnknownNameError):
            find(name)


def test_a_known_backend_that_is_not_installed_says_how_to_install_it(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), extras=("plain", "later"))
    assert backends.installable_backends() == {"later": 'pip install "orbit-core[later]"'}
    with pytest.raises(BackendNotInstalledError, match=r'pip install "orbit-core\[later\]"'):
        backends.backend("later")


def test_a_backend_whose_extra_is_not_installed_says_how_to_install_it(install: Install) -> None:
    plain = ("plain", "orbit-plain", PlainBackend)
    install(plain, ("plain-fast more", "orbit-plain", MeshBackend), ("plain-slow tested", "orbit-plain", MeshBackend))
    assert backends.backend_names() == ["plain", "plain-slow"]
    assert backends.installable_backends() == {"plain-fast": 'pip install "orbit-plain[more]"'}
    with pytest.raises(BackendNotInstalledError, match=r"'plain-fast' is not installed.*orbit-plain\[more\]"):
        backends.backend("plain-fast")
    install(("plain-fast more", "orbit-plain", MeshBackend), extras=("plain[more]",))
    assert backends.installable_backends() == {"plain-fast": 'pip install "orbit-core[plain]"'}


def test_of_this_distributions_extras_only_plugins_of_engines_are_installable_backends(install: Install) -> None:
    root = Path(__file__).resolve().parents[1]
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    install(extras=tuple(name for name, brought in extras.items() if any(f"orbit-{name}" in each for each in brought)))
    plugins = (tomllib.loads(path.read_text())["project"] for path in root.glob("plugins/*/pyproject.toml"))
    engines = {
        each["name"].removeprefix("orbit-") for each in plugins if "orbit.backends" in each.get("entry-points", {})
    }
    assert {*backends.installable_backends()} == engines


def test_a_matter_solver_is_installable_as_such_and_never_as_a_backend(install: Install) -> None:
    install(extras=("later", "matter"))
    assert [*backends.installable_backends()] == ["later"]
    assert backends.installable_matter() == {"orbit-matter": 'pip install "orbit-core[matter]"'}
    install(extras=("later", "matter"), matters=(("orbit-matter", "orbit-matter", None),))
    assert [*backends.installable_backends()] == ["later"]
    assert backends.installable_matter() == {}


def test_two_plugins_of_one_name_are_both_named_to_who_asks_for_it_alone(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), ("plain", "other-plain", PlainBackend), ("m", "m", MeshBackend))
    with pytest.warns(PluginWarning, match="backend 'plain' is registered twice"):
        assert backends.backend_names() == ["m"]
    assert isinstance(backends.backend("m"), MeshBackend)
    with pytest.raises(ConfigurationError, match=r"'plain'.*orbit-plain\) and by .*distribution other-plain"):
        backends.backend("plain")


def test_a_plugin_that_does_not_load_is_named_with_the_cause(install: Install) -> None:
    install(("broken", "orbit-broken", broken), ("number", "orbit-number", int), ("ends", "orbit-ends", sys.exit))
    with pytest.raises(ConfigurationError, match=r"broken:Backend.*orbit-broken.*ImportError: libengine.so"):
        backends.backend("broken")
    with pytest.raises(ConfigurationError, match=r"orbit-number\), makes a int, not an"):
        backends.backend("number")
    with pytest.raises(ConfigurationError, match=r"orbit-ends\) cannot be loaded \(SystemExit"):
        backends.backend("ends")


def test_a_scene_beyond_a_backend_is_refused_with_reason_and_alternatives(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), ("meshes", "orbit-meshes", MeshBackend), ("bad", "bad", broken))
    with pytest.raises(UnsupportedCapabilityError) as refusal:
        backends.check_scene(backends.backend("plain"), triangle_scene())
    message = str(refusal.value)
    for part in ("'plain'", "static triangle mesh collision", "'rock'", "it has hulls only", "choose backend 'meshes'"):
        assert part in message
    backends.check_scene(backends.backend("meshes"), triangle_scene())


def test_a_refusal_says_when_no_backend_would_do(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend))
    with pytest.raises(UnsupportedCapabilityError, match="no installed backend does"):
        backends.check_scene(backends.backend("plain"), triangle_scene())


def test_cameras_need_their_channels_of_what_draws(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), renderers=(("tracer", "orbit-tracer", Tracer),))
    plain, tracer = backends.backend("plain"), backends.renderer("tracer")
    scene = Scene(sensors=(CameraSpec(name="eye", channels=(Channel.POSITION,)),))
    backends.check_scene(plain, scene, tracer)
    with pytest.raises(UnsupportedCapabilityError, match=r"renderer 'plain'.*depth.*'eye'.*choose renderer 'tracer'"):
        backends.check_scene(plain, scene)
    colored = Scene(sensors=(CameraSpec(name="eye", channels=(Channel.RGB,)),))
    with pytest.raises(UnsupportedCapabilityError, match=r"renderer 'tracer'.*no installed renderer does"):
        backends.check_scene(plain, colored, tracer)
    with pytest.raises(UnsupportedCapabilityError, match=r"backend 'plain'.*mesh.*no installed backend does"):
        backends.check_scene(plain, triangle_scene(), tracer)


def test_settings_are_typed(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend))
    plain = backends.backend("plain")
    assert backends.backend_config(plain) == PlainConfig()
    assert backends.backend_config(plain, {"threads": 3, "solver": [1, 2]}) == PlainConfig(3, (1, 2))
    with pytest.raises(UnknownNameError, match=r"unknown setting 'thread' in backend 'plain': did you mean 'threads'"):
        backends.backend_config(plain, {"thread": 3})
    with pytest.raises(ConfigurationError, match="threads must not be negative"):
        backends.backend_config(plain, {"threads": -1})


def test_finding_backends_imports_none_of_them() -> None:
    code = (
        "import sys; from orbit_core import backends; names = backends.backend_names(); "
        "print(sorted({'torch', 'trimesh', *('orbit_' + n for n in names)} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_a_renderer_is_found_apart_from_backends(install: Install) -> None:
    install(("plain", "orbit-plain", PlainBackend), renderers=(("traced", "orbit-plain", MeshBackend),))
    assert backends.renderer_names() == ["traced"]
    assert isinstance(backends.renderer("traced"), MeshBackend)
    assert backends.renderer("plain") is backends.backend("plain")
    assert backends.default_backend() == "plain"
    with pytest.raises(ConfigurationError, match="give it as renderer"):
        backends.backend("traced")
    with pytest.raises(UnknownNameError, match=r"unknown renderer 'trace'.*'traced'"):
        backends.renderer("trace")


def test_who_names_no_backend_gets_the_chosen_or_the_only_one(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(("plain", "orbit-plain", PlainBackend))
    assert backends.default_backend() == "plain"
    install(("plain", "orbit-plain", PlainBackend), ("other", "orbit-other", PlainBackend))
    with pytest.raises(ConfigurationError, match="several backends are installed: say which, backend = 'other' or"):
        backends.default_backend()
    monkeypatch.setenv("ORBIT_BACKEND", "other")
    assert backends.default_backend() == "other"
    install(extras=("plain",))
    with pytest.raises(ConfigurationError, match="no backend is installed: pip install"):
        backends.default_backend()
