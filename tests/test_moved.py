"""Old import paths give the very things that are elsewhere now, with a warning."""

from __future__ import annotations

import importlib
import importlib.util

import pytest

from orbit_core import moved
from orbit_core.interfaces import ConfigurationError


@pytest.mark.parametrize("old", sorted(moved.MODULES))
def test_every_old_name_is_that_of_a_module_that_is_there(old: str) -> None:
    assert importlib.util.find_spec(moved.MODULES[old]) is not None


def test_an_old_name_gives_the_same_module() -> None:
    with pytest.warns(FutureWarning, match=r"orbit_core\.data\.states is orbit_data\.states now"):
        old = importlib.import_module("orbit_core.data.states")
    new = importlib.import_module("orbit_data.states")
    assert old is new
    assert new.__name__ == "orbit_data.states"
    assert new.__spec__ is not None
    assert new.__spec__.name == "orbit_data.states"


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("orbit_core.motion", "orbit_core.actions", "JointPositionConfig"),
        ("orbit_core.motion", "orbit_motion", "RmpFlowConfig"),
        ("orbit_core.assets", "orbit_assets.catalogue", "robot"),
        ("orbit_core.assets.object_kinds", "orbit_core.objects", "ObjectConfig"),
        ("orbit_core.envs", "orbit_motion.experts", "Expert"),
        ("orbit_core.envs", "orbit_motion.experts.starts", "ExpertStarts"),
        ("orbit_core.actions", "orbit_motion.full_ik", "FullIkTermConfig"),
        ("orbit_core.actions.grippers", "orbit_motion.synergies", "synergies_of"),
        ("orbit_core.actions.workspace", "orbit_core.actions.ik", "PoseFollower"),
        ("orbit_core.mdp.common", "orbit_motion.workspace", "arm"),
        ("orbit_core.mdp.common", "orbit_assets.objects", "work_bench"),
        ("orbit_core.dynamics.drive_design", "orbit_core.dynamics.rigid_body", "drive_responses"),
        ("orbit_core.cli.settings", "orbit_learn.cli.trained", "PlaySettings"),
        ("orbit_core.sensors", "orbit_data.bounding_boxes", "BoundingBoxes2d"),
        ("orbit_core.preparation.inertia", "orbit_core.preparation.merge", "combine"),
    ],
)
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_an_old_package_gives_what_it_exported(old: str, new: str, name: str) -> None:
    assert getattr(importlib.import_module(old), name) is getattr(importlib.import_module(new), name)


def test_a_name_that_never_was_is_no_module() -> None:
    with pytest.raises(ModuleNotFoundError, match="nothing"):
        importlib.import_module("orbit_core.nothing")
    with pytest.raises(AttributeError, match="nothing"):
        _ = importlib.import_module("orbit_motion").nothing


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_a_distribution_that_is_missing_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(moved.MODULES, "orbit_core.weather", "orbit_weather")
    with pytest.raises(ConfigurationError, match=r"is orbit_weather now.*pip install orbit-weather"):
        importlib.import_module("orbit_core.weather")
