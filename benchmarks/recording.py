"""What recording costs beside acting, stepping and drawing.

    python benchmarks/recording.py --backend mujoco --num-envs 64

Lift's expert is recorded, once with states and the policy's observations and once with two cameras' pictures of colour,
84 x 84. Prints the seconds of acting and stepping, of recording (what each step adds, writing the episodes that end,
and gathering all into one file), and of drawing: what the steps with pictures take longer than those without.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from orbit_core.envs import ObservationTerm, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.mdp.sensing import camera_color
from orbit_core.rollout.stepping import StepObserver, roll_out
from orbit_core.scene import Channel
from orbit_data.manifest.manifest import Manifest
from orbit_data.recording import DemonstrationRecorder, RecordingFile, Shares
from orbit_tasks.lift import Lift
from orbit_tasks.pixels import FRONT, HAND, ArmPixels

SIDE = 84


def camera(spec: Any) -> ObservationTerm:
    return camera_color(replace(spec, width=SIDE, height=SIDE, channels=(Channel.RGB,)))


@dataclass
class Pictures(ArmPixels):
    """What an arm knows of itself and its goal, and two pictures of colour."""

    hand_color: ObservationTerm | None = camera(HAND)
    hand_depth: ObservationTerm | None = None
    front_color: ObservationTerm | None = camera(FRONT)
    front_depth: ObservationTerm | None = None


@dataclass
class Observations:
    """All that is observed."""

    policy: Pictures = field(default_factory=Pictures)


class Timed(StepObserver):
    """Notes how long an observer takes."""

    def __init__(self, observer: StepObserver) -> None:
        self._observer = observer
        self.seconds = 0.0

    def before_step(self) -> None:
        begin = time.perf_counter()
        self._observer.before_step()
        self.seconds += time.perf_counter() - begin

    def stepped(self, action, result) -> None:
        begin = time.perf_counter()
        self._observer.stepped(action, result)
        self.seconds += time.perf_counter() - begin


def measured(arguments: argparse.Namespace, task: Lift) -> tuple[float, float, float]:
    """s of acting and stepping, of recording, and of gathering; an episode of each environment."""
    environment = make(replace(task, episode_length=arguments.seconds), arguments.num_envs, arguments.backend)
    with tempfile.TemporaryDirectory() as folder:
        file = RecordingFile(Path(folder) / "demonstrations.hdf5")
        file.take_up(Manifest.of(environment, "Lift", 0))
        environment.reset(0)
        shares = Shares(arguments.num_envs, environment)
        actor = scripted_actor("expert", environment, 0)
        environment.step(actor.act())  # what is made once
        environment.reset(0)
        recorder = DemonstrationRecorder(environment, file.parts, shares, 0)
        timed = Timed(recorder)
        pace = roll_out(environment, actor, (timed,), lambda: recorder.kept >= arguments.num_envs)
        begin = time.perf_counter()
        file.gather()
        gathering = time.perf_counter() - begin
    environment.close()
    return pace.seconds, timed.seconds, gathering


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=1.0, help="of an episode, 50 steps a second")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    for _ in range(arguments.rounds):
        stepping, recording, gathering = measured(arguments, Lift())
        share = recording / stepping
        print(f"states: steps {stepping:.2f} s, recording {recording:.2f} s ({share:.1%}), gathering {gathering:.2f} s")
        seen, recording, gathering = measured(arguments, Lift(observations=Observations()))
        drawing = seen - stepping
        times = (drawing + recording + gathering) / drawing
        told = f"recording {recording:.2f} s, gathering {gathering:.2f} s: {times:.2f} times the drawing"
        print(f"pictures: steps {seen:.2f} s, of which drawing {drawing:.2f} s, {told}", flush=True)


if __name__ == "__main__":
    main()
