"""Known parameters of a robot, recovered on every engine from a log that one engine made.

    python benchmarks/identification.py --made-on mujoco --fitted-on mujoco bullet sapien warp --output out/identified

Three joints of a Panda get friction, damping and armature, its drives a delay, its hand a payload. The log has some
seconds of steps as fast as the robot's limits allow, which are fitted, then ten of another motion to predict. Each
engine's fitted robot is a file that is accepted wherever a robot's name is; results are appended to ``results.jsonl``
next to it.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from orbit_assets.catalogue import robot
from orbit_assets.fitted import FittedRobot
from orbit_core.scene import RobotSpec, Scene
from orbit_deploy.identification import IdentificationSettings, identify
from orbit_deploy.local import LocalLink
from orbit_deploy.log import RobotLog
from orbit_deploy.log_replay import LogReplay, ParameterNames, fitted_joints, payload_link_of, predict, rms
from orbit_deploy.motion_log import read_log
from orbit_deploy.simulated import Imperfections, SimulatedHardware

PERIOD = 0.02
ROBOT = "franka_panda"
MOVED = ("panda_joint2", "panda_joint4", "panda_joint6")
# Of the part that is fitted: seconds of a step and its range, rad. Slow motions do not tell armature from delay.
STEP, RANGE = 0.3, 0.25
# Of the part that is predicted: frequencies by joint, rad/s, and amplitude, rad
FREQUENCIES, AMPLITUDE = (2.3, 3.7, 4.9), 0.25
SCALARS = ("delay", "payload")
QUANTITIES = ("friction", "damping", "armature")


def truth(spec: RobotSpec) -> FittedRobot:
    """Return the parameters to recover, on top of those that the robot has."""
    own = {joint.name: joint for joint in spec.articulation.joints}
    joints = {
        name: {"friction": 1.0 + 0.6 * i, "damping": 0.8 + 0.4 * i, "armature": own[name].armature + 0.05 + 0.03 * i}
        for i, name in enumerate(MOVED)
    }
    return FittedRobot(
        robot=ROBOT, source="known", joints=joints, payload_link=payload_link_of(spec), payload=0.7, delay=0.008
    )


def record(spec: RobotSpec, known: FittedRobot, backend: str, file: Path, seconds: float) -> None:
    """Write the log of a robot with these parameters, as its computer does."""
    scene = Scene(robots=(replace(known.apply(spec), name="robot"),), physics_dt=0.001)
    link = LocalLink(SimulatedHardware(scene, backend, 1000.0, Imperfections(delay=known.delay)), PERIOD)
    log = RobotLog(file, link.description)
    link.computer.on_state.append(lambda state: log.add(state.stamp, state))
    home, names = np.array(link.description.home), link.description.joints
    columns = [names.index(name) for name in MOVED]
    begun, random = link.now(), np.random.default_rng(0)
    steps = random.uniform(-RANGE, RANGE, (math.ceil(seconds / STEP), len(MOVED)))
    while (t := link.now() - begun) < seconds + 10.0:
        targets, since = home.copy(), t - seconds
        if since < 0.0:
            targets[columns] += steps[int(t / STEP)]
        else:
            targets[columns] += AMPLITUDE * np.sin(np.array(FREQUENCIES) * since)
        link.send(targets.tolist(), [0.0] * len(names), [0.0] * len(names))
        link.wait(link.now() + PERIOD)
    log.close()
    link.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--made-on", default="mujoco")
    parser.add_argument("--fitted-on", nargs="+", default=["mujoco"])
    parser.add_argument("--seconds", type=float, default=3.0, help="length that is fitted")
    parser.add_argument("--dt", type=float, default=None, help="seconds of a physics step of the fit")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.output.mkdir(parents=True, exist_ok=True)
    spec = robot(ROBOT)
    known = truth(spec)
    file = arguments.output / f"{arguments.made_on}.mcap"
    if not file.exists():
        record(spec, known, arguments.made_on, file, arguments.seconds)
    log = read_log(file).ordered(tuple(joint.name for joint in spec.articulation.movable_joints))
    fitting, later = log.selected(0.0, arguments.seconds), log.selected(arguments.seconds, None)
    moved = [log.joints.index(name) for name in MOVED]
    names = ParameterNames(fitted_joints(spec, fitting), QUANTITIES, SCALARS)
    true = {f"{what}:{joint}": each[what] for joint, each in known.joints.items() for what in QUANTITIES}
    true |= {"delay": known.delay, "payload": known.payload}

    def predicted(with_it: RobotSpec, backend: str, delay: float) -> float:
        """Degrees (rms) of the moved joints over the part that no fit has seen."""
        away = predict(later, with_it, backend, delay) - later.position
        return math.degrees(rms(away[:, moved]))

    for backend in arguments.fitted_on:
        begun = time.perf_counter()
        replay = LogReplay(fitting, spec, backend, names, known.payload_link, arguments.dt)
        found = identify(replay, ROBOT, backend, IdentificationSettings(generations=0), print)
        replay.close()
        found.fitted.write(arguments.output / f"{arguments.made_on}-on-{backend}.json")
        result = {
            "made_on": arguments.made_on,
            "fitted_on": backend,
            "seconds": time.perf_counter() - begun,
            "errors": {n: v / true[n] - 1.0 for n, v in zip(found.names, found.values.tolist(), strict=True)},
            "deviations": dict(zip(found.names, found.deviations.tolist(), strict=True)),
            "predicted_degrees": {
                "as described": predicted(spec, backend, 0.0),
                "known parameters": predicted(known.apply(spec), backend, known.delay),
                "fitted parameters": predicted(found.fitted.apply(spec), backend, found.fitted.delay),
            },
        }
        print(json.dumps(result, indent=1))
        with (arguments.output / "results.jsonl").open("a") as lines:
            lines.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
