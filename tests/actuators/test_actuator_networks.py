"""Actuator networks: fitted to a known series-elastic model, kept as data, evaluated step by step, and refused."""

from __future__ import annotations

import csv
import io
import math
import runpy
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from orbit_core.actuators import Actuators
from orbit_core.cli import main
from orbit_core.dynamics.random import RandomStreams
from orbit_core.envs import Environment
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError, NonFiniteError
from orbit_core.scene import ActuatorNetwork, DcMotor, IdealPd, Scene, Transmission, Windings
from orbit_data.reading.budget import ReadBudget
from orbit_data.tensor_file import write_tensors
from orbit_learn.actuators.networks import FitSettings, NetworkDescription, fit, read_network, write_network
from orbit_learn.actuators.recordings import QUANTITIES, read_recording
from orbit_tasks.velocity_flat import VelocityFlat
from tests.fuzz.watch import watched

SOURCE = Path(__file__).parents[2] / "tools" / "series_elastic.py"
Pendulums = Callable[..., Any]


@dataclass(kw_only=True)
class Learned(VelocityFlat):
    """Velocity-Flat whose robot's hips and thighs are driven by a network, its knees by motors that warm."""

    file: str

    def scene(self) -> Scene:
        scene = super().scene()
        knees = DcMotor(
            joints=(".*_calf_joint",),
            stiffness=40.0,
            damping=1.0,
            saturation_effort=20.0,
            no_load_speed=20.0,
            transmission=Transmission(positions=(-2.0, -1.0), ratios=(1.0, 2.0), rotor_inertia=0.001),
            windings=Windings(motor_constant=2.0, thermal_resistance=2.0, time_constant=0.5),
        )
        drives = (ActuatorNetwork(joints=(".*_(hip|thigh)_joint",), file=self.file), knees)
        return replace(scene, robots=(replace(scene.robots[0], actuators=drives),))


@pytest.fixture(scope="module")
def data() -> dict[str, np.ndarray]:
    """Twenty-five seconds of three series-elastic joints."""
    return runpy.run_path(str(SOURCE))["record"](25.0, joints=3)


@pytest.fixture(scope="module")
def recording(data: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "spring.npz"
    np.savez(path, **data)
    return path


def network(kind: str, tmp_path: Path, rate: float = 200.0, **more: Any) -> Path:
    """A file with a network of random weights; a pendulum's steps come at 200 Hz."""
    torch.manual_seed(1)
    history = (0, 1, 3) if kind == "mlp" else (0,)
    description = NetworkDescription(
        kind=kind, hidden_sizes=(5, 5), history=history, rate=rate, scales=(0.5, 2.0, 3.0), **more
    )
    write_network(tmp_path / "net.safetensors", description.build())
    return tmp_path / "net.safetensors"


def actuators_of(engine: Any) -> Actuators:
    random = RandomStreams(engine.num_envs, 0, engine.device)
    random.reset()
    return Actuators(engine, engine.layout, random)


def remembered(actuators: Any) -> torch.Tensor:
    """Past of the network among the models of some actuators."""
    return next(model.memory["past"] for model in actuators.models.values() if "past" in model.memory)


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_a_fit_is_far_better_than_the_best_pd_law(kind: str, recording: Path) -> None:
    found = fit([read_recording(recording)], FitSettings(kind=kind, passes=80))
    assert found.line_error > 3.0, "a PD law cannot tell what the spring and the motor's limit do"
    assert found.error < 0.6 * found.line_error


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_step_by_step_is_the_whole_sequence_and_a_file_keeps_it(kind: str, tmp_path: Path) -> None:
    path = network(kind, tmp_path)
    module = read_network(path)
    inputs = torch.randn(12, 3, 2)
    past = module.past(3, torch.device("cpu"))
    steps = []
    for now in inputs:
        efforts, past = module.step(now, past)
        steps.append(efforts)
    torch.testing.assert_close(torch.stack(steps), module.sequence(inputs))


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_every_joint_and_environment_has_a_past_of_its_own(kind: str, tmp_path: Path, pendulums: Pendulums) -> None:
    file = str(network(kind, tmp_path))
    groups = (ActuatorNetwork(joints=("joint_[ac]",), file=file), IdealPd(joints=("joint_b",), stiffness=2.0))
    engine = pendulums(groups)
    actuators, module = actuators_of(engine), read_network(Path(file))
    states, targets = torch.randn(8, 2, 2, 3), torch.randn(8, 2, 3)
    given = []
    for (q, v), target in zip(states, targets, strict=True):
        engine.q[:], engine.v[:] = q, v
        actuators.position_targets[:] = target
        actuators.effort_targets[:] = 0.1
        actuators.apply()
        given.append(engine.efforts.clone())
    inputs = torch.stack((targets - states[:, 0], states[:, 1]), -1)[:, :, [0, 2]]
    limits = torch.as_tensor(engine.layout.joint_parameters.effort_limit).float()[[0, 2]]
    expected = (module.sequence(inputs.flatten(1, 2)).view(8, 2, 2) + 0.1).clamp(-limits, limits)
    torch.testing.assert_close(torch.stack(given)[:, :, [0, 2]], expected)
    torch.testing.assert_close(given[0][:, 1], 2.0 * (targets[0] - states[0, 0])[:, 1] + 0.1)
    saved = actuators.save_state()
    actuators.reset(torch.tensor([1]))
    actuators.position_targets[:], engine.q[:], engine.v[:] = targets[0], states[0, 0], states[0, 1]
    actuators.effort_targets[:] = 0.1
    actuators.apply()
    torch.testing.assert_close(engine.efforts[1], given[0][1])
    assert (engine.efforts[0, [0, 2]] - given[0][0, [0, 2]]).abs().max() > 1e-4, "the other environment remembers"
    actuators.load_state(saved)
    assert torch.equal(remembered(actuators), saved.memory[-1]["past"])
    with pytest.raises(ConfigurationError, match="'joint_a' is driven by a NetworkModel, which has no gains"):
        actuators.set_gains([0], torch.ones(2, 1), torch.ones(2, 1))


def test_a_network_that_does_not_fit_is_refused_in_one_line(tmp_path: Path, pendulums: Pendulums) -> None:
    def refused(path: Path, message: str) -> None:
        engine = pendulums((ActuatorNetwork(joints=("joint_.*",), file=str(path)),))
        with pytest.raises(ConfigurationError, match=message):
            actuators_of(engine)

    refused(network("lstm", tmp_path, rate=400.0), r"fitted at 400 Hz, .* come at 200 Hz: set physics_dt=0\.0025")
    refused(network("mlp", tmp_path, unit="m"), r"positions are in m, and those of joint 'joint_a' are in rad")
    refused(tmp_path / "none.safetensors", "there is no file")
    module = read_network(network("lstm", tmp_path))
    document = {"format": 1, "actuator": {"kind": "lstm", "hidden_sizes": [6, 6], "rate": 200.0}}
    write_tensors(tmp_path / "net.safetensors", document, module.state_dict())
    refused(
        tmp_path / "net.safetensors", r"'memory\.weight_ih_l0' is \[20, 2\], .* hidden sizes \[6, 6\] has \[24, 2\]"
    )
    write_tensors(tmp_path / "net.safetensors", {"format": 1, "policy": {}}, module.state_dict())
    refused(tmp_path / "net.safetensors", "holds no actuator network")
    with pytest.raises(ConfigurationError, match="layers of one size"):
        NetworkDescription(kind="lstm", hidden_sizes=(8, 4), rate=200.0)


def test_recordings_of_three_formats_are_the_same(data: dict[str, np.ndarray], recording: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "spring.h5", "w") as file:
        for name, values in data.items():
            file[name] = values.astype("S") if name == "joints" else values
    columns = [(joint, quantity) for joint in range(3) for quantity in QUANTITIES]
    with (tmp_path / "spring.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"joint_{joint}.{quantity}" for joint, quantity in columns)])
        for step, time in enumerate(data["time"]):
            writer.writerow([time, *(data[quantity][step, joint] for joint, quantity in columns)])
    first = read_recording(recording)
    assert first.rate == pytest.approx(200.0)
    for name in ("spring.h5", "spring.csv"):
        other = read_recording(tmp_path / name)
        assert other.joints == first.joints == ("joint_0", "joint_1", "joint_2")
        torch.testing.assert_close(other.inputs, first.inputs)
        torch.testing.assert_close(other.efforts, first.efforts)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"effort": None}, ConfigurationError, "lacks effort"),
        (
            {"velocity": np.zeros((5000, 2))},
            ConfigurationError,
            r"velocity is \(5000, 2\), with 5000 times and 3 joints",
        ),
        ({"time": np.arange(5000) ** 1.1}, ConfigurationError, "resample it evenly"),
        ({"time": 1.0 - np.arange(5000.0)}, ConfigurationError, "time does not rise after 1 s"),
        ({"joints": np.array(["a", "b", "a"])}, ConfigurationError, "names a joint twice: a, b, a"),
        ({"position": np.zeros((5000, 3), complex)}, ConfigurationError, "position is of complex128"),
        ({"effort": np.zeros((5000, 3))}, ConfigurationError, "one effort throughout"),
        ({"time": np.float64(3.0)}, ConfigurationError, "time has 0 dimensions"),
        ({"joints": np.arange(3)}, ConfigurationError, "no list of names"),
        ({"joints": np.array(["a", "b\x1b[31m", "c"])}, ConfigurationError, "no name of an array"),
        ({"velocity": np.full((5000, 3), 1e300)}, ConfigurationError, r"holds 1e\+300, which no joint reaches"),
        ({"velocity": np.zeros((5000, 3), bool)}, ConfigurationError, "velocity is of bool"),
        ({"effort": np.full((5000, 3), np.nan)}, NonFiniteError, "effort is not finite in step 0"),
    ],
)
def test_a_recording_that_cannot_be_is_refused(
    data: dict[str, np.ndarray], tmp_path: Path, change: dict[str, Any], kind: type[Exception], message: str
) -> None:
    changed = {name: value for name, value in {**data, **change}.items() if value is not None}
    np.savez(tmp_path / "bad.npz", **changed)
    with pytest.raises(kind, match=message):
        read_recording(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty"),
        ("garbage", "lacks time"),
        ("time,position,velocity,effort\n0,1,2,3\n", "names no joint"),
        ("time,a.position\n0,1\n0.005\n", "row 2 has 1 values, and the header names 2 columns"),
        ("time,a.position\n0,none\n", "could not convert string to float: 'none'"),
        ("time,a.position\n0,\0\n", "cannot be read"),
        ('time,a.position\n"' + 200_000 * "x", "field larger than field limit"),
        ("1," * 600_000, "a line has more than 1,048,576 characters"),
        ("time,a.position\n0,1+2j\n", "could not convert string to float"),
    ],
)
def test_a_table_that_is_broken_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_recording(path)


def archive(
    path: Path, shape: tuple[int, ...], dtype: str = "<f8", data: bytes = b"", version: bytes = b"\1\0"
) -> Path:
    """An archive with an array whose header claims a shape."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    text = header.getvalue()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("time.npy", text[:6] + version + text[8:] + data)
    return path


def test_an_archive_that_claims_what_it_does_not_hold_is_refused(tmp_path: Path) -> None:
    for shape, options, message in (
        ((10**9,), {}, "would have 8,000,000,000 bytes, and holds 0"),
        ((-1,), {}, r"has shape \(-1,\)"),
        ((10**200,), {}, "cannot be read"),
        ((3,), {"dtype": "|O"}, "no numbers or texts"),
        ((3,), {"version": b"\x09\0"}, "cannot be read"),
        ((5 * 10**6,), {"data": bytes(4 * 10**7)}, "next to nothing is stored"),
        ((3,), {"data": bytes(24)}, "lacks joints, position_target"),
    ):
        path = archive(tmp_path / "bad.npz", shape, **options)  # pyright: ignore[reportArgumentType]
        with pytest.raises(ConfigurationError, match=message):
            read_recording(path)
    locked = bytearray(archive(tmp_path / "locked.npz", (3,), data=bytes(24)).read_bytes())
    locked[6] |= 1  # encrypted, as the archive's flags say, in both places
    locked[locked.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(locked)
    with pytest.raises(ConfigurationError, match="encrypted"):
        read_recording(path)
    path.write_bytes(b"PK\5\6" + bytes(5) + b"PK\3\4" + bytes(40))
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_recording(path)


def test_a_recording_is_held_to_its_budget(recording: Path, tmp_path: Path) -> None:
    for budget, message in ((ReadBudget(bytes=1000), "--read-bytes"), (ReadBudget(seconds=1e-9), "--read-seconds")):
        with pytest.raises(ConfigurationError, match=message):
            read_recording(recording, budget)


@pytest.mark.parametrize("name", ["time", "position", "joints"])
def test_a_recording_in_hdf5_opens_no_other_file(name: str, data: dict[str, np.ndarray], tmp_path: Path) -> None:
    secret, path = tmp_path / "secret.h5", tmp_path / "a.h5"
    for link in (h5py.ExternalLink("secret.h5", f"/{name}"), h5py.SoftLink("/velocity"), None):
        for target in (secret, path):
            with h5py.File(target, "w") as file:
                for each, values in data.items():
                    file[each] = values.astype("S") if each == "joints" else values
        with h5py.File(path, "r+") as file:
            del file[name]
            if link is None:
                file.create_dataset(name, data[name].shape, "u1", external=[(str(secret), 0, data[name].size)])
            else:
                file[name] = link
        with watched([secret]) as touched, pytest.raises(ConfigurationError):
            read_recording(path)
        assert not touched


def test_a_recording_in_hdf5_that_unpacks_to_more_than_it_should_is_refused(
    data: dict[str, np.ndarray], tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in data.items():
            if name != "position":
                file[name] = [str(each) for each in values] if name == "joints" else values
        file.create_dataset("position", (5000, 100_000), "f8", chunks=(5000, 100), compression="gzip")
    with pytest.raises(ConfigurationError, match="would be 4 GB, of which next to nothing is stored"):
        read_recording(tmp_path / "a.h5")


def test_what_is_no_archive_is_told_so(tmp_path: Path) -> None:
    path = tmp_path / "text.npz"
    path.write_text("hello")
    with pytest.raises(ConfigurationError, match="is no NPZ archive"):
        read_recording(path)


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf, 1e30])
def test_a_fit_that_would_not_learn_is_refused(rate: float) -> None:
    with pytest.raises(ConfigurationError, match="learning_rate"):
        FitSettings(learning_rate=rate)


def test_a_fit_that_cannot_be_judged_or_diverges_is_told(data: dict[str, np.ndarray], tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="more than 64 bits"):
        FitSettings(seed=10**30)
    np.savez(tmp_path / "short.npz", **{n: v if n == "joints" else v[:60] for n, v in data.items()})  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=r"60 steps, of which a fifth is held out.*record more than 100"):
        fit([read_recording(tmp_path / "short.npz")], FitSettings(passes=1))
    np.savez(tmp_path / "whole.npz", **{n: v if n == "joints" else v[:300] for n, v in data.items()})  # pyright: ignore[reportArgumentType]
    whole = read_recording(tmp_path / "whole.npz")
    settings = FitSettings(passes=3)
    object.__setattr__(settings, "learning_rate", 1e30)
    with pytest.raises(ConfigurationError, match="the fit diverged in pass"):
        fit([whole], settings)


def test_the_command_writes_a_file_that_a_world_takes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pendulums: Pendulums
) -> None:
    output = tmp_path / "knee.safetensors"
    assert main(["train-actuator", str(recording), "--output", str(output), "--kind", "mlp", "--passes", "2"]) == 0
    told = capsys.readouterr()
    assert "error of the best PD law" in told.out
    assert "no better than a PD law" in told.err
    assert read_network(output).description.fitted_to == ("joint_0", "joint_1", "joint_2")
    assert actuators_of(pendulums((ActuatorNetwork(joints=("joint_.*",), file=str(output)),))).explicit


def test_a_captured_step_is_the_step_that_it_stands_for(tmp_path: Path) -> None:
    file = str(network("lstm", tmp_path))
    environments = []
    for captured in (False, True):
        env = Environment(Learned(file=file, robot="unitree_go2", episode_length=0.2), 3, "mujoco")
        if captured:
            env._closed = CapturedStep(env, compile=False, whole=True)
        env.reset(seed=0)
        environments.append(env)
    torch.manual_seed(0)
    for _ in range(14):
        action = torch.rand(3, 12) - 0.5
        first, second = (env.step(action) for env in environments)
        torch.testing.assert_close(second[0]["policy"], first[0]["policy"])
    pasts = [remembered(env.world.actuators) for env in environments]
    torch.testing.assert_close(pasts[1], pasts[0])
    heat = [env.world.robots["robot"].motor_temperatures for env in environments]
    torch.testing.assert_close(heat[1], heat[0])
    assert (heat[0] > 25.0).any(1).all()
    for env in environments:
        env.close()
