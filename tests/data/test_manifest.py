"""The manifest says what an environment is, survives its file, and tells every difference by how grave it is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import make_dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from orbit_core.backends import backend_names, default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, make
from orbit_core.envs.observation_layout import groups_of, terms_of_group
from orbit_core.envs.registry import task_entries
from orbit_core.envs.terms import unit_of
from orbit_core.interfaces import ConfigurationError
from orbit_data.manifest.manifest import Kind, Manifest, check_manifest, differences
from orbit_data.manifest.plain import as_plain, digest
from orbit_learn.networks import perceptron, perceptron_actor
from orbit_learn.policy import Policy, PolicyActor, PolicyDescription, load_policy
from orbit_learn.pretrained import policy_path, pretrained_policies

BACKEND = default_backend()
OTHER = next(name for name in backend_names() if name != BACKEND)


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 2, BACKEND, seed=5)
    yield made
    made.close()


@pytest.fixture(scope="module")
def manifest(environment: Environment) -> Manifest:
    return Manifest.of(environment, "Lift", 5)


def test_a_manifest_describes_robot_observation_and_action(manifest: Manifest) -> None:
    robot = manifest.robots["robot"]
    assert robot.joint_names[0] == "panda_joint1"
    assert robot.stiffness[:2] == (400.0, 400.0)
    assert robot.home_positions[3] == pytest.approx(-2.81)
    group = manifest.observations["policy"]
    assert group.concatenated
    assert group.terms["cube_pose"].unit == "m, quaternion (w, x, y, z)"
    assert {name for name, term in group.terms.items() if not term.unit} == set()
    arm, gripper = manifest.action_terms.values()
    assert arm.offset == robot.home_positions[:7]
    assert arm.scale == (2.0,) * 7
    assert gripper.components == ("opening",)
    assert gripper.scale is None
    assert (manifest.step_dt, manifest.decimation, manifest.seed) == (0.02, 4, 5)
    assert manifest.assets.keys() == {"robot", "cube", "table"}
    assert manifest.configuration["rewards"]["lift"]["weight"] == 15.0
    assert manifest.configuration["events"]["place_robot"]["function"]["bound"]["spread"] == 0.05
    assert "orbit" in manifest.versions


def test_a_manifest_survives_its_file(manifest: Manifest) -> None:
    read = Manifest.decode(manifest.encode(), "here")
    assert read.encode() == manifest.encode()
    assert differences(manifest, read) == []


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x80\x04", "here holds no manifest"),
        (b"[]", "format None"),
        (b'{"format": 99}', "format 99"),
        (b'{"format": 1, "task": 7}', "task"),
    ],
)
def test_what_is_no_manifest_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Manifest.decode(data, "here")


def test_the_same_task_elsewhere_differs_in_notes_alone(manifest: Manifest) -> None:
    elsewhere = make("Lift", 1, OTHER)
    found = check_manifest(manifest, elsewhere, "the dataset")
    elsewhere.close()
    assert {difference.kind for difference in found} == {Kind.NOTE}
    assert "backend" in {difference.path for difference in found}


def test_other_actions_are_refused_and_named(manifest: Manifest) -> None:
    elsewhere = make("Lift", 1, BACKEND, action="ik_relative", **{"observations.policy.goal": None})
    with pytest.raises(ConfigurationError, match="the dataset does not fit") as told:
        check_manifest(manifest, elsewhere, "the dataset")
    elsewhere.close()
    for path in ("observations.policy.terms.goal was there", "action_terms.joint_position was there"):
        assert path in str(told.value)


def test_other_gains_and_physics_warn_and_other_rewards_are_noted(manifest: Manifest) -> None:
    robot = replace(manifest.robots["robot"], damping=(1.0,) * 9)
    changed = replace(manifest, robots={"robot": robot}, decimation=8, assets={**manifest.assets, "cube": "~0"})
    kinds = {difference.path: difference.kind for difference in differences(manifest, changed)}
    assert kinds == dict.fromkeys(("robots.robot.damping", "decimation", "assets.cube"), Kind.WARNING)
    group = replace(
        manifest.observations["policy"], terms=dict(reversed(manifest.observations["policy"].terms.items()))
    )
    (found,) = differences(manifest, replace(manifest, observations={"policy": group}))
    assert found.kind is Kind.ERROR
    assert "in order" in str(found)


def test_a_digest_tells_apart_what_numbers_functions_and_constants_differ_in() -> None:
    def scaled(factor: float):
        return lambda value: factor * value

    values = [torch.zeros(100), torch.ones(100), scaled(1.0), scaled(2.0), {"a": 1}, {"a": 1.5}, float("inf"), None]
    assert len({digest(value) for value in values}) == len(values)
    assert digest(torch.zeros(100)) == digest(torch.zeros(100))
    json.dumps(as_plain(values), allow_nan=False)


def test_a_digest_is_the_same_where_a_machine_rounds_otherwise() -> None:
    exact = [np.linspace(-1.0, 1.0, 99), np.diag([0.5, 0.1, 2e-7]), (1.0, 0.0, 0.0), 0.1]
    nudged = [exact[0] * (1 + 2e-16) - 1e-17, exact[1] - 1e-19, (1.0 - 1e-16, -0.0, 1e-17), 0.1 + 2e-17]
    assert [digest(value) for value in exact] == [digest(value) for value in nudged]
    assert digest(np.diag([0.5, 0.1, 2e-7])) != digest(np.diag([0.5, 0.1, 3e-7]))
    assert digest(0.1) != digest(0.1000001)


def test_a_digest_is_the_same_where_a_field_is_new_that_is_not_used() -> None:
    old = make_dataclass("Thing", [("size", float)])
    new = make_dataclass("Thing", [("size", float), ("margin", float | None, None)])
    assert digest(old(1.0)) == digest(new(1.0)) != digest(new(1.0, 0.0))


def test_a_digest_of_before_they_were_rounded_is_noted_and_no_warning(manifest: Manifest) -> None:
    old, other = (replace(manifest, assets={**manifest.assets, "cube": d}) for d in ("0123456789abcdef", "~0123"))
    assert [difference.kind for difference in differences(old, manifest)] == [Kind.NOTE]
    assert [difference.kind for difference in differences(other, manifest)] == [Kind.WARNING]


def untrained(environment: Environment, manifest: Manifest) -> Policy:
    actor = perceptron_actor(perceptron(environment.observation_size, (8,), environment.action_size))
    description = PolicyDescription.of(environment, "Lift", "rsl-rl", 0)
    return Policy(actor.module, actor.network, description, manifest)


def test_a_policy_and_its_onnx_carry_the_manifest(environment: Environment, manifest: Manifest, tmp_path: Path) -> None:
    policy = untrained(environment, manifest)
    policy.save(tmp_path / "policy_0.safetensors")
    policy.export_onnx(tmp_path / "policy.onnx")
    for path in (tmp_path, tmp_path / "policy.onnx"):
        read = load_policy(path).manifest
        assert read is not None
        assert read.encode() == manifest.encode()
    own = {entry.key: entry.value for entry in onnx.load(str(tmp_path / "policy.onnx")).metadata_props}
    assert own["joint_names"].split(",") == [*manifest.robots["robot"].joint_names]
    assert own["joint_stiffness"] == ",".join(["400.000"] * 7 + ["2000.000", "0.000"])
    assert own["observation_names"].split(",")[2] == "cube_pose"
    assert own["observation_terms_clip"].split(",")[0] == "-inf;inf"
    assert "action_scale" not in own  # the gripper's command is no scaled position


def test_a_policy_is_held_against_the_environment(environment: Environment, manifest: Manifest, tmp_path: Path) -> None:
    robot = replace(manifest.robots["robot"], damping=(1.0,) * 9)
    untrained(environment, replace(manifest, robots={"robot": robot})).save(tmp_path / "policy_0.safetensors")
    with pytest.warns(UserWarning, match=r"robots\.robot\.damping was 1, 1, .* and is 80, 80"):
        PolicyActor(environment, tmp_path)
    group = manifest.observations["policy"]
    scaled = replace(group, terms={**group.terms, "goal": replace(group.terms["goal"], scale=0.1)})
    untrained(environment, replace(manifest, observations={"policy": scaled})).save(tmp_path / "policy_1.safetensors")
    with pytest.raises(ConfigurationError, match=r"policy\.terms\.goal\.scale was 0\.1 and is 1"):
        PolicyActor(environment, tmp_path)


def test_every_task_says_the_unit_of_each_term() -> None:
    for name, entry in task_entries().items():
        task = entry.task_type()()
        for group_name, group in groups_of(task).items():
            unnamed = [term_name for term_name, term in terms_of_group(group).items() if not unit_of(term)]
            assert not unnamed, f"{name}'s group {group_name} has terms of no unit: {unnamed}"


def test_a_policy_of_before_there_were_manifests_gets_todays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy, old = load_policy(policy_path("reach")), tmp_path / "policy_1.safetensors"
    before = replace(policy, manifest=None, description=replace(policy.description, backend="one of before"))
    before.save(old)
    assert main(["export", str(old), "--output", str(tmp_path / "out")]) == 0
    assert "holds no manifest" in capsys.readouterr().err
    for name in ("policy.safetensors", "policy.onnx"):
        manifest = load_policy(tmp_path / "out" / name).manifest
        assert manifest is not None
        assert (manifest.task, manifest.num_envs) == ("Reach", 1)

    record = {"settings": {"seed": 3, "num_envs": 99, "device": "cuda"}, "versions": {"torch": "1.0"}}
    (tmp_path / "training.json").write_text(json.dumps(record))
    assert main(["export", str(old), "--amend"]) == 0
    amended = load_policy(old)
    assert amended.description == before.description
    assert amended.manifest is not None
    assert (amended.manifest.seed, amended.manifest.num_envs, amended.manifest.versions) == (3, 99, {"torch": "1.0"})
    assert "of the environment that the policy fitted" in amended.manifest.made_later
    assert main(["export", str(old), "--amend"]) == 2
    assert "holds a manifest already" in capsys.readouterr().err


def test_every_kept_policy_has_a_manifest_that_says_whether_it_was_made_later() -> None:
    manifests = {name: load_policy(kept.folder).manifest for name, kept in pretrained_policies().items()}
    later = {name for name, manifest in manifests.items() if manifest is not None and manifest.made_later}
    assert None not in manifests.values()
    assert later == {
        "cabinet", "cloth_lifting", "lift", "lift_pixels", "reach", "reach_pixels", "velocity_flat",
    }  # fmt: skip
