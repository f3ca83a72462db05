"""An exported runtime in C++ builds ORBIT's observation and gives its joint targets, for each kind of term."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli.making import make_environment
from orbit_core.envs import Environment, make
from orbit_data.manifest.manifest import Manifest
from orbit_learn import runtime
from orbit_learn.cli.export import main as export
from orbit_learn.cli.play import played
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.policy import Policy, load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.runtime import runtime_document, write_runtime
from orbit_learn.runtime.cpp import cpp_header
from orbit_tasks.lift import LiftObservations, LiftState
from tests.learning.test_runtime import jacobians_of, measured_of, untrained

BACKEND = default_backend()
COMPILER = shutil.which("g++") or shutil.which("c++")
needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="there is no C++ compiler: neither g++ nor c++ is installed"
)

# A folder with include/ and lib/ of onnxruntime; without it, those of the system count
_PREFIX = Path(os.environ.get("ORBIT_ONNXRUNTIME", "/usr"))


def _first(*patterns: str) -> Path | None:
    return next((found for pattern in patterns for found in sorted(_PREFIX.glob(pattern))), None)


HEADER = _first("include/onnxruntime_cxx_api.h", "include/onnxruntime/onnxruntime_cxx_api.h",
                "include/onnxruntime/core/session/onnxruntime_cxx_api.h")  # fmt: skip
LIBRARY = _first("lib/libonnxruntime.so*", "lib/*-linux-gnu/libonnxruntime.so*")
needs_onnxruntime = pytest.mark.skipif(
    HEADER is None or LIBRARY is None,
    reason=f"onnxruntime for C++ lacks its {'header onnxruntime_cxx_api.h' if HEADER is None else 'library'} under "
    f"{_PREFIX}: apt-get install libonnxruntime-dev (Debian 13), or name a folder with include/ and lib/ by "
    "ORBIT_ONNXRUNTIME",
)

# Without onnxruntime the test takes the network's place and answers each observation with ORBIT's action.
PROGRAM = r"""
#include <iostream>
#include <cstdio>
#include "orbit_policy.hpp"

static std::vector<float> read(std::size_t size) {
  std::vector<float> values(size);
  for (float& value : values) std::cin >> value;
  return values;
}

static void write(const std::vector<float>& values) {
  for (float value : values) std::printf("%.9g ", value);
  std::printf("\n");
  std::fflush(stdout);
}

struct Asked : orbit::Network {
  void run(const std::vector<float>& observation, std::vector<float>& action) override {
    write(observation);
    action = read(action.size());
  }
};

int main() {
#ifdef ORBIT_WITH_ONNXRUNTIME
  orbit::OnnxNetwork network("policy.onnx");
#else
  Asked network;
#endif
  orbit::Runtime policy(orbit::description(), network);
  std::printf("%.17g %zu", policy.period(), policy.action().size());
  for (const std::string& joint : policy.joints()) std::printf(" %s", joint.c_str());
  std::printf("\n");
  std::fflush(stdout);
  std::string word;
  while (std::cin >> word) {
    if (word == "reset") { policy.reset(); continue; }
    std::vector<std::vector<float>> measured, jacobians;
    for (const auto& term : policy.description().observations)
      measured.push_back(term.last_action ? std::vector<float>{} : read(term.components.size()));
    std::vector<float> positions = read(policy.joints().size());
    for (const auto& term : policy.description().actions)
      jacobians.push_back(read(term.kind == orbit::ActionKind::ik_relative ? 6 * term.joints.size() : 0));
    write(policy.step(measured, positions, jacobians));
  }
}
"""

REFUSED = r"""
#include <iostream>
#include "orbit_policy.hpp"

struct Zero : orbit::Network {
  void run(const std::vector<float>&, std::vector<float>&) override {}
};

int main() {
  Zero network;
  orbit::Runtime policy(orbit::description(), network);
  const std::vector<std::pair<std::vector<std::vector<float>>, std::vector<float>>> cases{
      {{}, {}}, {{{1.0f, 2.0f}}, {}}, {{{1.0f}}, {1.0f}}};
  for (const auto& [measured, positions] : cases) {
    try {
      policy.step(measured, positions);
    } catch (const std::invalid_argument& error) {
      std::cout << error.what() << "\n";
    }
  }
}
"""


class Program:
    """Compiled runtime, spoken to by lines."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        period, size, *self.joints = self._line().split()
        self.period, self.action_size = float(period), int(size)

    def reset(self) -> None:
        self._send("reset")

    def measure(self, numbers: Sequence[np.ndarray]) -> None:
        """Send what was measured."""
        self._send("step " + _text(np.concatenate([each.reshape(-1) for each in numbers])))

    def observe(self, numbers: Sequence[np.ndarray]) -> np.ndarray:
        """Send what was measured, and return the observation that the network is asked with."""
        self.measure(numbers)
        return np.array(self._line().split(), np.float64)

    def decode(self, action: torch.Tensor) -> dict[str, float]:
        """Give the network's answer, and return targets by joint."""
        self._send(_text(action.numpy()))
        return self.targets()

    def targets(self) -> dict[str, float]:
        """Return targets by joint."""
        return dict(zip(self.joints, map(float, self._line().split()), strict=True))

    def _send(self, text: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


@contextmanager
def compiled(folder: Path, more: Sequence[str] = ()) -> Iterator[Program]:
    assert COMPILER is not None
    (folder / "main.cpp").write_text(PROGRAM)
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    words = [COMPILER, *flags, "main.cpp", "-o", "main", *more]
    subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True)
    process = subprocess.Popen([folder / "main"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield Program(process)
    finally:
        process.terminate()
        process.wait()


def numbers_of(environment: Environment, program: Program) -> list[np.ndarray]:
    """Measured numbers of each term, then positions in the program's order."""
    robot = environment.world.robots["robot"]
    measured, positions = measured_of(environment), robot.joint_positions[0].tolist()
    numbers = [values for name, values in measured.items() if not name.endswith("last_action")]
    return [*numbers, np.array([positions[robot.joint_names.index(joint)] for joint in program.joints])]


def check_targets(targets: dict[str, float], environment: Environment) -> None:
    """Compare a program's targets with those that ORBIT sent in its last step."""
    world = environment.world
    assert len(targets) >= 8
    for joint, target in targets.items():
        column = world.layout.joints_by_name.index(("robot", joint))
        sent = float(world.actuators.position_targets[0, column])  # pyright: ignore[reportAttributeAccessIssue]
        assert target == pytest.approx(sent, abs=1e-5), joint


def compare(program: Program, environment: Environment, policy: Policy, manifest: Manifest) -> None:
    """Run ORBIT and the program next to each other, over the end of an episode too."""
    assert program.period == pytest.approx(environment.step_dt)
    assert program.action_size == environment.action_size
    actions = runtime_document(policy, manifest, environment)["actions"]
    for step in range(20):
        if step == 10:
            environment.reset(3)
            program.reset()
        numbers = numbers_of(environment, program)
        jacobians = jacobians_of(environment)
        numbers += [jacobians[each["name"]] for each in actions if each["kind"] == "ik_relative"]
        expected = environment.observe()["policy"]
        assert isinstance(expected, torch.Tensor)
        assert program.observe(numbers) == pytest.approx(expected[0].numpy(), abs=1e-5)
        action = policy.module(expected).clamp(-1.0, 1.0).detach()
        targets = program.decode(action[0])
        environment.step(action)
        check_targets(targets, environment)


@needs_compiler
@pytest.mark.parametrize("name", ["reach", "lift"])
def test_a_runtime_in_cpp_acts_as_orbit_does(name: str, tmp_path: Path) -> None:
    export([name, "--runtime", str(tmp_path)])
    environment = make_environment(played(PlaySettings(policy=Path(name), backend=BACKEND)), 1)
    policy = load_policy(policy_path(name))
    with compiled(tmp_path) as program:
        compare(program, environment, policy, Manifest.of(environment, policy.description.task, 0))
    environment.close()


@needs_compiler
@needs_onnxruntime
@pytest.mark.parametrize("name", ["reach", "lift"])
def test_a_runtime_in_cpp_with_onnxruntime_acts_as_orbit_does(name: str, tmp_path: Path) -> None:
    assert HEADER is not None
    export([name, "--runtime", str(tmp_path)])
    environment = make_environment(played(PlaySettings(policy=Path(name), backend=BACKEND)), 1)
    policy = load_policy(policy_path(name))
    # Another's header need not pass our warnings.
    flags = ["-DORBIT_WITH_ONNXRUNTIME", "-isystem", str(HEADER.parent), str(LIBRARY), f"-Wl,-rpath,{_PREFIX / 'lib'}"]
    with compiled(tmp_path, flags) as program:
        for step in range(20):
            if step == 10:
                environment.reset(3)
                program.reset()
            program.measure(numbers_of(environment, program))
            observation = environment.observe()["policy"]
            assert isinstance(observation, torch.Tensor)
            # Its own action is the last one that the program observes in its next step.
            environment.step(policy.module(observation).clamp(-1.0, 1.0).detach())
            check_targets(program.targets(), environment)
    environment.close()


@needs_compiler
@pytest.mark.parametrize("action", ["ik_relative", "joint_position_relative"])
def test_runtimes_in_cpp_of_other_action_spaces_and_with_a_history_act_as_orbit_does(
    action: str, tmp_path: Path
) -> None:
    environment = make("Lift", 1, BACKEND, action=action, observations=LiftObservations(policy=LiftState(history=3)))
    policy, manifest = untrained(environment)
    write_runtime(tmp_path, policy, manifest, environment)
    with compiled(tmp_path) as program:
        compare(program, environment, policy, manifest)
    environment.close()


@needs_compiler
def test_the_runtime_in_cpp_refuses_numbers_that_do_not_fit(tmp_path: Path) -> None:
    document: dict[str, Any] = {
        "task": "Hold",
        "robot": None,
        "step_dt": 0.02,
        "observations": {
            "angle": {
                "offset": [0.0],
                "scale": 1.0,
                "history": 1,
                "unit": "rad",
                "formula": 'a "quoted" angle',
                "frame": "",
                "components": ["x"],
            }
        },
        "actions": [],
    }
    shutil.copy(Path(runtime.__file__).with_name("orbit_runtime.hpp"), tmp_path)
    (tmp_path / "orbit_policy.hpp").write_text(cpp_header(document))
    (tmp_path / "main.cpp").write_text(REFUSED)
    assert COMPILER is not None
    subprocess.run([COMPILER, "-std=c++17", "main.cpp", "-o", "main"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout.splitlines()
    assert said == [
        "there are 1 observation terms, and numbers of 0",
        "observation term 'angle' has 1 numbers, not 2",
        "there are 0 joints, and positions of 1",
    ]
