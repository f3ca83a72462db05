"""Distributions that are missing, of the wrong version or installed twice are named, with the command that cures it."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import packaging.requirements
import packaging.specifiers  # loaded before a test hides the folder that it is in
import packaging.version
import pytest

from orbit_core import __version__, distributions, installing
from orbit_core.distributions import DistributionWarning, check_distribution, warn_of_copies
from orbit_core.installing import install_command, install_extra, upgrade_command
from orbit_core.interfaces import ConfigurationError
from tests.distributions import ROOT
from tests.forked import run_forked

Folder = Callable[..., Path]


def forget_what_is_installed() -> None:
    for cached in (distributions._installed, distributions._check_needs, distributions.warn_of_copies):
        cached.cache_clear()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Folder]:
    """Write a distribution's metadata into a folder and search that folder, and those made before, only."""
    searched: list[str] = []
    monkeypatch.setattr(sys, "path", searched)
    monkeypatch.setattr(installing, "checkout", lambda: None)
    forget_what_is_installed()

    def write(name: str, version: str, *needs: str, where: str = "site", source: str = "", **points: str) -> Path:
        folder = tmp_path / where
        if str(folder) not in searched:
            searched.append(str(folder))
        return write_distribution(folder, name, version, *needs, source=source, **points)

    yield write
    forget_what_is_installed()


def write_distribution(folder: Path, name: str, version: str, *needs: str, source: str = "", **points: str) -> Path:
    """Write what pip leaves of a distribution; keywords are entry points by group, with ``_`` in place of the dot."""
    about = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    about.mkdir(parents=True)
    requires = "".join(f"Requires-Dist: {need}\n" for need in needs)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{requires}")
    groups = "".join(f"[{group.replace('_', '.')}]\n{point}\n" for group, point in points.items())
    (about / "entry_points.txt").write_text(groups)
    if source:
        (about / "direct_url.json").write_text(json.dumps({"url": f"file://{source}", "dir_info": {"editable": True}}))
    return folder


def test_versions_in_range_pass(install: Folder) -> None:
    install("orbit-core", "0.1.3", 'orbit-plain~=0.1.0 ; extra == "plain"', "numpy>=1.26")
    install("orbit-assets", "0.1.0", "orbit-core~=0.1.0", "trimesh>=4")
    install("orbit_plain", "0.1.7", "orbit_core (~=0.1.2)", "orbit-assets[usd]>=0.1,<0.2; python_version > '3'")
    check_distribution("orbit-plain")
    check_distribution("orbit-nowhere")


@pytest.mark.parametrize(
    ("core", "needs", "message"),
    [
        ("0.2.0", "~=0.1.0", "orbit-plain 0.1.0 works with orbit-core~=0.1.0, and orbit-core 0.2.0 is installed: pip "
         "install --upgrade orbit-plain"),
        ("0.1.4", "~=0.1.5", 'orbit-core 0.1.4 is installed: pip install "orbit-core~=0.1.5"'),
        ("0.1.0", "~=0.2.0", 'orbit-core 0.1.0 is installed: pip install "orbit-core~=0.2.0"'),
        ("0.4.0", ">=0.1,<0.3", "orbit-core 0.4.0 is installed: pip install --upgrade orbit-plain"),
        ("0.2.0.dev1", "~=0.1.0", "pip install --upgrade orbit-plain"),
    ],
)  # fmt: skip
def test_a_core_out_of_range_is_named_with_the_command(install: Folder, core: str, needs: str, message: str) -> None:
    install("orbit-core", core)
    install("orbit-plain", "0.1.0", f"orbit-core{needs}")
    with pytest.raises(ConfigurationError) as fault:
        check_distribution("orbit-plain")
    assert message in str(fault.value)


def test_what_a_distribution_needs_is_checked_in_turn(install: Folder) -> None:
    install("orbit-core", "0.2.0")
    install("orbit-tasks", "0.2.0", "orbit-core~=0.2.0", "orbit-motion~=0.2.0")
    install("orbit-motion", "0.2.0", "orbit-core~=0.2.0", "orbit-assets~=0.2.0")
    install("orbit-assets", "0.1.0", "orbit-core~=0.1.0")
    with pytest.raises(
        ConfigurationError, match=r"orbit-motion 0.2.0 works with orbit-assets~=0.2.0.*\"orbit-assets~="
    ):
        check_distribution("orbit-tasks")


def test_a_plugin_that_asks_for_any_core_is_held_to_the_cores_own_range(install: Folder) -> None:
    install("orbit-core", "0.2.0", "orbit-newton[sim]~=0.2.0 ; extra == 'newton'")
    install("orbit-newton", "0.1.0", "orbit-core")
    with pytest.raises(ConfigurationError, match=r"pip install \"orbit-newton~=0\.2\.0\"$"):
        check_distribution("orbit-newton")


def test_a_distribution_that_another_needs_is_named_where_it_is_missing(install: Folder) -> None:
    install("orbit-core", "0.1.0")
    install("orbit-tasks", "0.1.0", "orbit-core~=0.1.0", "orbit-weather~=0.1.0")
    with pytest.raises(ConfigurationError, match=r"needs orbit-weather, which is not installed: pip install orbit-wea"):
        check_distribution("orbit-tasks")


def test_a_plugin_that_runs_from_its_source_is_to_be_brought_up_to_date(install: Folder, tmp_path: Path) -> None:
    install("orbit-core", "0.2.0")
    install("orbit-mine", "0.1.0", "orbit-core~=0.1.0", source=f"{tmp_path}/mine")
    with pytest.raises(ConfigurationError, match=r"update the source in .*/mine, then pip install -e .*/mine$"):
        check_distribution("orbit-mine")


def test_two_copies_are_warned_of_once_with_both_places(install: Folder, tmp_path: Path) -> None:
    install("orbit-core", "0.1.0", where="wheels")
    install("orbit-core", "0.2.0", where="site", source=f"{tmp_path}/checkout")
    with pytest.warns(DistributionWarning) as caught:
        warn_of_copies("orbit-core")
    (warning,) = caught
    message = str(warning.message)
    assert f"orbit-core is installed twice, version 0.1.0 in {tmp_path}/wheels and version 0.2.0 in" in message
    assert f"in {tmp_path}/checkout, and" in message
    assert f"remove {tmp_path}/wheels and {tmp_path}/site from PYTHONPATH" in message


def test_two_versions_in_one_environment_are_cured_by_pip(
    install: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    install("orbit-core", "0.1.0")
    install("orbit-core", "0.2.0")
    cure = "pip uninstall -y orbit-core && pip uninstall -y orbit-core && pip install orbit-core"
    with pytest.warns(DistributionWarning, match=cure):
        warn_of_copies("orbit-core")


@pytest.mark.filterwarnings("error")
def test_one_copy_is_no_fault(install: Folder, tmp_path: Path) -> None:
    """Neither is a development install, whose source folder may have metadata of its own."""
    install("orbit-core", "0.1.0")
    install("orbit-mine", "0.1.0", where="site", source=f"{tmp_path}/mine")
    install("orbit-mine", "0.1.0", where="mine/src")
    for name in ("orbit-core", "orbit-mine", "orbit-nowhere"):
        warn_of_copies(name)


_PLUGINS = """
from dataclasses import dataclass
from orbit_core.interfaces import Backend, Capabilities

@dataclass(frozen=True)
class Config:
    pass

class Unstated(Backend):
    name, config_type = "unstated", Config

    def capabilities(self):
        return Capabilities({})

    def create_engine(self, *arguments):
        raise NotImplementedError

class Fitting(Unstated):
    name, contract = "fitting", (1, 0)

class Text(Unstated):
    name, contract = "text", "1.0"

class Later(Unstated):
    name, contract = "later", (1, 99)

class Former(Backend):  # whose methods had other names
    name, contract = "former", (0, 9)

def register(registry):
    registry.add("Juggle", "Keep three balls in the air", "theirs:Juggle")
    registry.add("Lift", "Another lift", "theirs:Lift")
"""


def errors_of(folder: Path, code: str, *names: str) -> dict[str, str]:
    """Return the message of the error, empty where there is none, of a function ``load`` called with each name."""
    program = f"""
import json, sys
from orbit_core.interfaces import OrbitError
{code}
messages = {{}}
for name in sys.argv[1:]:
    try:
        load(name)
    except OrbitError as error:
        messages[name] = str(error)
    else:
        messages[name] = ""
print(json.dumps(messages))
"""
    done = run_forked(program, *names, path=[folder])
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def theirs(folder: Path, *needs: str, **points: str) -> Path:
    (folder / "theirs.py").write_text(_PLUGINS)
    return write_distribution(folder, "theirs", "1.0", *needs, **points)


def test_a_backend_for_another_contract_is_named_with_the_command(tmp_path: Path) -> None:
    names = ("unstated", "fitting", "text", "later", "former", "gone", "unimportable")
    (tmp_path / "broken.py").write_text("from orbit_core.interfaces import GoneWithTheLastVersion\n")
    points = [f"{name} = theirs:{name.title()}" for name in names[:-2]]
    theirs(tmp_path, orbit_backends="\n".join([*points, "gone = broken:It", "unimportable = orbit_weather:It"]))
    errors = errors_of(tmp_path, "from orbit_core.backends import backend as load", *names)
    core = f"orbit-core {__version__} has 1.0: "
    assert errors["fitting"] == ""
    assert errors["former"].startswith("backend 'former', entry point 'former' (theirs:Former, of distribution theirs)")
    assert f"written for version 0.9 of the contract, and {core}pip install --upgrade theirs" in errors["former"]
    assert f"written for version 1.99 of the contract, and {core}" in errors["later"]
    assert upgrade_command("orbit-core") in errors["later"]
    assert f"does not state the version of the contract that it was written for, and {core}" in errors["unstated"]
    assert (
        "pip install --upgrade theirs, or, if it is your own, say contract = (1, 0) in Unstated" in errors["unstated"]
    )
    assert "states contract = '1.0', which is no pair of whole numbers such as (1, 0)" in errors["text"]
    assert "written for another version of orbit_core: pip install --upgrade theirs" in errors["gone"]
    assert errors["unimportable"].endswith("(ModuleNotFoundError: No module named 'orbit_weather'): "
                                           "pip install orbit-weather")  # fmt: skip


def test_a_plugin_out_of_range_is_refused_before_it_is_imported(tmp_path: Path) -> None:
    write_distribution(tmp_path, "theirs", "1.0", "orbit-core~=9.0.0", orbit_backends="theirs = not_there:Theirs")
    errors = errors_of(tmp_path, "from orbit_core.backends import backend as load", "theirs")
    assert errors["theirs"].startswith("theirs 1.0 works with orbit-core~=9.0.0, and orbit-core ")


def test_tasks_out_of_range_give_one_error_or_one_warning(tmp_path: Path) -> None:
    theirs(tmp_path, "orbit-core~=9.0.0", orbit_tasks="theirs = theirs:register")
    for words, code in ((("run", "Juggle", "--backend", "mujoco"), 2), (("list", "tasks"), 0)):
        asked = run_forked(_ORBIT, *words, path=[tmp_path])
        assert asked.returncode == code
        assert asked.stderr.count("theirs 1.0 works with orbit-core~=9.0.0") == 1


def test_two_of_one_name_say_how_to_pick_one(tmp_path: Path) -> None:
    theirs(
        tmp_path,
        orbit_tasks="theirs = theirs:register",
        orbit_backends="mujoco = theirs:Fitting",
        orbit_objects="box = orbit_assets.object_kinds:BoxConfig",
        orbit_actuators="ActuatorNetwork = theirs:Fitting",
        orbit_decompositions="coacd = theirs:register",
    )
    code = """
from orbit_core.actuators.actuators import actuator_models
from orbit_core.backends import backend
from orbit_core.envs.registry import task_entry
from orbit_core.objects import object_config
from orbit_core.preparation.scenes import decompositions

def load(name):
    loads = dict(Lift=task_entry, mujoco=backend, box=object_config, ActuatorNetwork=actuator_models().get,
                 coacd=decompositions().get)
    loads[name](name)
"""
    owners = {
        "Lift": "orbit-tasks",
        "mujoco": "orbit-mujoco",
        "box": "orbit-assets",
        "ActuatorNetwork": "orbit-learn",
        "coacd": "orbit-assets",
    }
    for name, error in errors_of(tmp_path, code, *owners).items():
        assert f"'{name}' is registered twice, by entry point" in error
        assert "rename one, or pip uninstall " in error
        assert "pip uninstall theirs" in error
        assert f"pip uninstall {owners[name]}" in error


_ORBIT = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"


def test_every_door_names_the_distribution_that_is_missing(tmp_path: Path) -> None:
    code = """
import importlib_metadata
from orbit_core import distributions
importlib_metadata.entry_points = lambda group: []
distributions.is_installed = lambda name: False

from orbit_core.actions import motion_generators
from orbit_core.actions.presets import _leading
from orbit_core.actuators.actuators import model_of
from orbit_core.backends import matter_solver
from orbit_core.cli import info, listing
from orbit_core.cli.making import check_actor, make_environment
from orbit_core.cli.run import RunSettings
from orbit_core.envs.registry import task_entry
from orbit_core.objects import object_config
from orbit_learn.pretrained import pretrained_policy
from orbit_assets.catalogue import robot
from orbit_core.scene import ActuatorNetwork

def load(name):
    loads = dict(Lift=task_entry, franka_panda=robot, box=object_config, rmpflow=motion_generators().get,
                 reach=pretrained_policy, walker=check_actor, libraries=listing.lists().get)
    loads["Reach"] = lambda name: info.main([name])
    loads["ur10+hand"] = robot
    loads["some action"] = lambda name: _leading(None, name)
    loads["no task"] = lambda name: make_environment(RunSettings(task=None), 1)
    loads["network"] = lambda name: model_of(object.__new__(ActuatorNetwork), "robot")
    loads["orbit-matter"] = matter_solver
    loads[name](name)
"""
    owners = {
        "Lift": "orbit-tasks",
        "Reach": "orbit-tasks",
        "no task": "orbit-tasks",
        "franka_panda": "orbit-assets",
        "ur10+hand": "orbit-assets",
        "box": "orbit-assets",
        "rmpflow": "orbit-motion",
        "some action": "orbit-motion",
        "reach": "orbit-policies",
        "walker": "orbit-learn",
        "network": "orbit-learn",
        "libraries": "orbit-learn",
    }
    for name, error in errors_of(tmp_path, code, *owners).items():
        assert f"the distribution {owners[name]} is not installed: {install_command(owners[name])}" in error, name
    solver = errors_of(tmp_path, code, "orbit-matter")["orbit-matter"]
    assert f"it is not installed: {install_extra('matter')}" in solver


def test_commands_of_a_checkout_work_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "my checkout"
    (root / "plugins/orbit-bullet").mkdir(parents=True)
    (root / "plugins/orbit-bullet/pyproject.toml").write_text('dependencies = ["orbit-core~=0.1.0"]\n')
    monkeypatch.setattr(installing, "checkout", lambda: root)
    monkeypatch.chdir(root)
    assert install_extra("bullet") == 'pip install -r checkout.txt -e plugins/orbit-bullet -e ".[bullet]"'
    monkeypatch.chdir(tmp_path)
    assert install_command("orbit-bullet") == f"cd '{root}' && pip install -r checkout.txt -e plugins/orbit-bullet"
    monkeypatch.setattr(installing, "checkout", lambda: None)
    assert install_extra("bullet") == 'pip install "orbit-core[bullet]"'


def test_make_demo_installs_every_distribution_that_its_own_need() -> None:
    # pip finds no distribution of a checkout that is not named to it.
    named = re.search(r"^DEMO := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert named
    folders = [ROOT, ROOT / "orbit_tasks", *(ROOT / f"packages/orbit-{name}" for name in named[1].split())]
    folders += [ROOT / "plugins/orbit-mjmodel", ROOT / "plugins/orbit-mujoco"]
    projects = [tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"] for folder in folders]
    needed = {packaging.requirements.Requirement(text).name for each in projects for text in each["dependencies"]}
    missing = {name for name in needed if name.startswith("orbit-")} - {each["name"] for each in projects}
    assert not missing


def test_uv_takes_every_distribution_from_the_checkout() -> None:
    uv = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["uv"]
    folders = [ROOT, *(folder for member in uv["workspace"]["members"] for folder in ROOT.glob(member))]
    projects = [folder / "pyproject.toml" for folder in folders if (folder / "pyproject.toml").is_file()]
    names = {tomllib.loads(project.read_text(encoding="utf-8"))["project"]["name"] for project in projects}
    assert {*uv["sources"]} == names
