"""What each motion generator costs: the time of a control step beyond that of the physics.

    python benchmarks/motion_generators.py --device cpu --envs 1 64 4096

A control step is one command and four physics steps, for which servos run four times. The robot's state is read anew
each time, and the engine does not step: the figures are the generators' own. On a GPU the turns are captured in a CUDA
graph where the device allows it, as a captured step has them. Prints a table in Markdown, ms. Of generators that plan
for one environment it is the time of a plan, for which a world that steps in no time waits; a dash is what is refused.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import torch

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.actions import ActionTerm, motion_generators, with_drives_for
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.scene import ContactSensorSpec, Scene
from orbit_core.world import simulate
from orbit_motion.compliant import Servo
from orbit_motion.mpc.predictive import Predictive

ROBOTS = {
    "base_velocity": "base_omni_franka_panda",
    "whole_body_ik": "base_omni_franka_panda",
    "differential_drive": "tiago",
    "grasp_synergies": "allegro_right",
    "locomotion": "anymal_c",
    "trunk_mpc": "unitree_go2",
}
"""By generator; all others move a Franka."""
SENSED = ("hybrid", "admittance")
DECIMATION = 4


def world_of(term: ActionTerm, name: str, envs: int, device: str, backend: str) -> World:
    """The robot on the ground, which is an obstacle, with a sensor of contacts on all of it where that is read."""
    spec = catalogue_robot(ROBOTS.get(name, "franka_panda"))
    sensor = ContactSensorSpec(name="touch", entity=spec.name)
    sensors = (sensor,) if name in SENSED else ()
    scene = Scene(robots=(with_drives_for(spec, {name: term}),), sensors=sensors)
    return simulate(scene, envs, backend, device=device)


def control_step(name: str, envs: int, device: str, backend: str) -> tuple[Callable[[], None], World]:
    """One command, and the turns that follow it."""
    config = motion_generators().get(name)
    robot_name = catalogue_robot(ROBOTS.get(name, "franka_panda")).name
    term = config(robot=robot_name, **({"sensor": "touch"} if name in SENSED else {}))
    world = world_of(term, name, envs, device, backend)
    generator = term.build(name, world.robots[robot_name])
    generator.enter(world, DECIMATION * world.physics_dt)
    command = 0.1 * torch.ones(envs, generator.command_size, device=device)
    plans = isinstance(generator, Predictive)
    turns = round(1.0 / (generator.config.rate * DECIMATION * world.physics_dt)) if plans else 1

    def step() -> None:
        world.clock.touch()
        for _ in range(turns):
            generator.compute({"command": command})
        for _ in range(DECIMATION if isinstance(generator, Servo) else 0):
            world.clock.touch()
            generator.turn()

    return step, world


def captured(step: Callable[[], None]) -> Callable[[], None]:
    """The step as a CUDA graph."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def milliseconds(step: Callable[[], None], device: str, seconds: float) -> float:
    """The median of as many steps as fit."""
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < 5 or time.perf_counter() - begin < seconds:
        start = time.perf_counter()
        step()
        if device != "cpu":
            torch.cuda.synchronize()
        times.append(1e3 * (time.perf_counter() - start))
    return sorted(times)[len(times) // 2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--envs", type=int, nargs="+", default=[1, 64, 4096])
    parser.add_argument("--only", nargs="*", help="names of generators")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each figure")
    arguments = parser.parse_args()
    names = [name for name in motion_generators().names if not arguments.only or name in arguments.only]
    print(f"| generator | {' | '.join(str(count) for count in arguments.envs)} |\n|---|{'---|' * len(arguments.envs)}")
    with torch.inference_mode():
        for name in names:
            cells: list[str] = []
            for count in arguments.envs:
                try:
                    step, world = control_step(name, count, arguments.device, arguments.backend)
                except ConfigurationError as refused:
                    print(refused, file=sys.stderr)
                    cells.append("-")
                    continue
                for _ in range(2):
                    step()
                run = step if arguments.device == "cpu" else captured(step)
                cells.append(f"{milliseconds(run, arguments.device, arguments.seconds):.2f}")
                world.close()
            print(f"| `{name}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
