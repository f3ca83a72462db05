"""Kept policies are found by entry point, whoever brings them, and a file that says nonsense is told of."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_learn.pretrained import policy_fields, policy_path, pretrained_policies, pretrained_policy
from tests.forked import run_forked

ABOUT = 'description = "Stacks cubes"\nleast_success = 0.8\n'
FIELDS = '[fields]\nobservations = "pixels"\n'
GAP = '[[gaps]]\nbackend = "slippery"\nleast_success = 0.5\nreason = "it slips"\n'


def install(folder: Path, about: str, name: str = "pile") -> None:
    """A distribution as a third party might install it, with one policy."""
    package = folder / "their_policies" / name
    package.mkdir(parents=True)
    (package / "policy.toml").write_text(about)
    (folder / "their_policies" / "no_policy").mkdir()
    described = folder / "their_policies-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: their-policies\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text("[orbit.policies]\ntheirs = their_policies\n")


def ask(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    return run_forked(code, path=[folder])


def test_the_suite_keeps_policies_that_are_held_to_something() -> None:
    assert {"cabinet", "reach", "velocity_flat"} <= {*pretrained_policies()}
    assert list(pretrained_policies()) == sorted(pretrained_policies())
    assert min(policy.least_success for policy in pretrained_policies().values()) > 0.5


def test_another_package_brings_policies_of_its_own(tmp_path: Path) -> None:
    install(tmp_path, ABOUT + FIELDS + GAP)
    told = ask(
        tmp_path,
        "from orbit_learn.pretrained import *; pile = pretrained_policy('pile');"
        "print(pile.least_success, pile.gap_on('slippery').reason, pile.gap_on('other'),"
        "len(pretrained_policies()), policy_fields('pile'))",
    )
    numbers = f"0.8 it slips None {len(pretrained_policies()) + 1}"
    assert told.stdout.split("\n")[0] == f"{numbers} {{'observations': 'pixels'}}", told.stderr
    listed = ask(tmp_path, "from orbit_core.cli import main; main(['list', 'policies'])").stdout
    assert "pile" in listed
    assert "Stacks cubes" in listed


@pytest.mark.parametrize(
    ("about", "name", "complaint"),
    [
        (ABOUT.replace("0.8", "80"), "pile", "least_success is a rate in [0, 1], not 80"),
        (ABOUT + "speed = 3\n", "pile", "unexpected keyword argument 'speed'"),
        (ABOUT + 'fields = "pixels"\n', "pile", "fields is a table of the task's fields, not 'pixels'"),
        (ABOUT + GAP.replace('backend = "slippery"', ""), "pile", "a gap names a backend, a renderer or both"),
        (ABOUT + GAP.replace("reason", "cause"), "pile", "unexpected keyword argument 'cause'"),
        ("description = \n", "pile", "is not TOML"),
        (ABOUT, "reach", "policy 'reach' is registered twice"),
    ],
)
def test_what_is_wrong_with_a_policy_is_told(tmp_path: Path, about: str, name: str, complaint: str) -> None:
    install(tmp_path, about, name)
    told = ask(tmp_path, "from orbit_core.cli import main; main(['list', 'policies'])").stderr
    assert complaint in " ".join(told.split())
    assert "their_policies" in told


def test_the_fields_stand_beside_the_policy_file_under_its_name_and_its_path(tmp_path: Path) -> None:
    folder = pretrained_policy("reach_pixels").folder
    (file,) = folder.glob("policy_*.safetensors")
    for name in ("reach_pixels", folder, file):
        assert policy_fields(name) == {"observations": "pixels"}
    assert policy_fields(tmp_path) == policy_fields("reach") == {}


def test_a_path_is_taken_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert policy_path("reach") == pretrained_policy("reach").folder
    Path("reach").mkdir()
    assert policy_path("reach") == Path("reach")
    with pytest.raises(UnknownNameError, match="did you mean 'reach'"):
        policy_path("raech")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fields = 3", "fields"),
        ("description = 5", "description"),
        ("[[gaps]]\nleast_success = 'x'\nreason = 1", "describes no policy"),
        ("x = " + "[" * 900 + "]" * 900, "describes no policy"),
        ("x = " + "9" * 6000, "describes no policy"),
        ("# " + "x" * (1 << 20), "larger than 1,048,576 bytes"),
    ],
)
def test_a_description_of_a_policy_that_cannot_be_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "policy.toml").write_text(f"{text}\n")
    if text.startswith(("fields", "description")):
        whole = {"description": "description = 'x'", "least_success": "least_success = 0.5"}
        others = [line for name, line in whole.items() if not text.startswith(name)]
        (tmp_path / "policy.toml").write_text("\n".join([text, *others]))
    with pytest.raises(ConfigurationError, match=message):
        policy_fields(tmp_path)
