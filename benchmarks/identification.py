"""Known parameters of a robot, recovered on every engine from a log that one engine made.

    python benchmarks/identification.py --made-on mujoco --fitted-on mujoco bullet sapien warp --output out/identified

All joints of an arm get friction, damping and armature, its drives a delay and a gain, its hand a payload. The log has
some seconds of :class:`~orbit_deploy.excitation.Excitation`, which are fitted, then ten of another motion to predict.
Each engine's fitted robot is a file that is accepted wherever a robot's name is; results are appended to
``results.jsonl`` next to it.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import torch

from orbit_assets.catalogue import robot
from orbit_assets.fitted import FittedRobot
from orbit_core.scene import RobotSpec, Scene
from orbit_deploy.description import RobotDescription
from orbit_deploy.excitation import PERIOD, Excitation, ExcitationSettings, excite
from orbit_deploy.identification import LONGEST_DELAY, IdentificationSettings, identify
from orbit_deploy.local import LocalLink
from orbit_deploy.log import RobotLog
from orbit_deploy.log_replay import LogReplay, ParameterNames, fitted_joints, payload_link_of, predict, rms
from orbit_deploy.motion_log import read_log
from orbit_deploy.simulated import Imperfections, SimulatedHardware

SCALARS = ("delay", "payload", "gain")
QUANTITIES = ("friction", "damping", "armature")
# Hz of the robot's loop, and of the physics of all engines
RATE = 500.0
# Seconds of the motion that is predicted
PREDICTED = 10.0


def truth(spec: RobotSpec, name: str) -> FittedRobot:
    """Return the parameters to recover, on top of those that the robot has."""
    described = RobotDescription.of(spec)
    own = {joint.name: joint for joint in spec.articulation.joints}
    joints: dict[str, dict[str, float]] = {}
    for column in Excitation(described).moved:
        # Wrists have less of everything than shoulders.
        share, joint = min(described.effort[column] / 87.0, 1.0) ** 0.5, described.joints[column]
        size = share * (0.6 + 0.1 * (column % 4))
        added = {"friction": 1.5 * size, "damping": 1.5 * size, "armature": 0.08 * size}
        joints[joint] = {what: getattr(own[joint], what) + value for what, value in added.items()}
    return FittedRobot(
        robot=name,
        source="known",
        joints=joints,
        payload_link=payload_link_of(spec),
        payload=0.7,
        delay=0.008,
        gain=0.95,
    )


def record(spec: RobotSpec, known: FittedRobot, backend: str, files: Sequence[Path], lengths: Sequence[float]) -> None:
    """Write logs of a robot with these parameters, as its computer does, each of a motion of some length."""
    scene = Scene(robots=(replace(known.apply(spec), name="robot"),), physics_dt=1.0 / RATE)
    link = LocalLink(SimulatedHardware(scene, backend, RATE, Imperfections(delay=known.delay)), PERIOD)
    for seed, (file, seconds) in enumerate(zip(files, lengths, strict=True)):
        log = RobotLog(file, link.description)
        excite(link, Excitation(link.description, ExcitationSettings(seconds=seconds, seed=seed)), log)
        log.close()
    link.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="franka_panda")
    parser.add_argument("--made-on", default="mujoco")
    parser.add_argument("--fitted-on", nargs="+", default=["mujoco"])
    parser.add_argument("--slopes", default="mujoco", help="engine that computes the derivatives of all fits")
    parser.add_argument("--seconds", type=float, default=4.0, help="length that is fitted")
    parser.add_argument("--dt", type=float, default=None, help="seconds of a physics step of the fit")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.output.mkdir(parents=True, exist_ok=True)
    spec = robot(arguments.robot)
    known = truth(spec, arguments.robot)
    stem = f"{arguments.robot}-{arguments.made_on}"
    files = [arguments.output / f"{stem}-{part}.mcap" for part in ("fitted", "predicted")]
    if not all(file.exists() for file in files):
        record(spec, known, arguments.made_on, files, (arguments.seconds, PREDICTED))
    order = tuple(joint.name for joint in spec.articulation.movable_joints)
    fitting, later = (read_log(file).ordered(order) for file in files)
    moved = [fitting.joints.index(name) for name in known.joints]
    names = ParameterNames(fitted_joints(spec, fitting), QUANTITIES, SCALARS)
    true = {f"{what}:{joint}": each[what] for joint, each in known.joints.items() for what in QUANTITIES}
    true |= {name: getattr(known, name) for name in SCALARS}

    def predicted(with_it: RobotSpec, backend: str, delay: float) -> float:
        """Degrees (rms) of the moved joints over the motion that no fit has seen."""
        away = predict(later, with_it, backend, delay) - later.position
        return math.degrees(rms(away[:, moved]))

    def replayed(backend: str) -> LogReplay:
        return LogReplay(fitting, spec, backend, names, known.payload_link, arguments.dt, LONGEST_DELAY)

    for backend in arguments.fitted_on:
        begun = time.perf_counter()
        with closing(replayed(backend)) as replay, closing(replayed(arguments.slopes)) as slopes:
            found = identify(replay, arguments.robot, backend, IdentificationSettings(), print, slopes)
        seconds = time.perf_counter() - begun
        found.fitted.write(arguments.output / f"{stem}-on-{backend}.json")
        determined = [name for name, value in zip(found.names, found.deviations, strict=True) if math.isfinite(value)]
        errors = {
            name: value / true[name] - 1.0 for name, value in zip(found.names, found.values.tolist(), strict=True)
        }
        result = {
            "robot": arguments.robot,
            "made_on": arguments.made_on,
            "fitted_on": backend,
            "seconds": seconds,
            "fit_rms_degrees": math.degrees(found.after),
            "undetermined": [name for name in found.names if name not in determined],
            "largest_error": {
                what: max((abs(errors[name]) for name in determined if name.split(":")[0] == what), default=math.nan)
                for what in (*QUANTITIES, *SCALARS)
            },
            "errors": errors,
            "deviations": dict(zip(found.names, found.deviations.tolist(), strict=True)),
            "predicted_degrees": {
                "as described": predicted(spec, backend, 0.0),
                "fitted parameters": predicted(found.fitted.apply(spec), backend, found.fitted.delay),
            },
        }
        print(json.dumps(result, indent=1), flush=True)
        with (arguments.output / "results.jsonl").open("a") as lines:
            lines.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
