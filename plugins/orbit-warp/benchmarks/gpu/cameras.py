"""Measures cameras: how many pictures of Lift a second, with stepping and without, and what they take of memory.

    python3 plugins/orbit-warp/benchmarks/gpu/cameras.py --num-envs 1024 --sizes 64 128

A frame is one environment's colour and depth picture. ``drawn`` draws the same poses again and again; ``stepped`` steps
the task with random actions and draws nothing; ``seen`` steps the task with a camera in its scene, and reads its images
after each step. Rates are medians over blocks. Memory is what the device has less of afterwards. ``drawn`` is measured
for each number of ``--threads`` of a block of rays; ``seen`` takes the fastest.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from orbit_core import backends
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.scene import CameraSpec, Channel, Scene, look_at
from orbit_tasks.lift import Lift
from orbit_warp import renderer as warp_renderer

CHANNELS = (Channel.RGB, Channel.DEPTH)


@dataclass(kw_only=True)
class SeenLift(Lift):
    """Lift with a camera that looks at the table."""

    camera: CameraSpec

    def scene(self) -> Scene:
        scene = super().scene()
        return replace(scene, sensors=(*scene.sensors, self.camera))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, default=1024)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128], help="pixels along a side")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--frames", type=int, default=100, help="pictures, or steps, of a block")
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--threads", type=int, nargs="+", default=[64, 128, 256], help="threads of a block of rays")
    parser.add_argument("--no-shadows", action="store_true")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    arguments = parser.parse_args()
    rows = [measure(arguments, size) for size in arguments.sizes]
    print_table(rows)
    print(json.dumps(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


def measure(arguments: argparse.Namespace, size: int) -> dict[str, object]:
    """Measure one size of picture."""
    camera = CameraSpec(
        name="camera", width=size, height=size, channels=CHANNELS, pose=look_at((1.3, -0.6, 0.8), (0.4, 0.0, 0.1))
    )
    settings = {"shadows": not arguments.no_shadows}
    num_envs, device = arguments.num_envs, torch.device(arguments.device)

    def started(task: Lift) -> tuple[Environment, Callable[[], None]]:
        environment = make(task, num_envs, "warp", device, settings=settings)
        environment.reset(seed=0)
        actions = [2 * torch.rand(num_envs, environment.action_size, device=device) - 1 for _ in range(16)]
        return environment, lambda: environment.step(actions[int(torch.randint(16, (1,)))])

    free = [free_memory(device)]
    plain, step = started(Lift())
    stepped = timed(step, device, arguments)
    free.append(free_memory(device))
    draw = drawing(plain, camera, settings)
    drawn_by_threads: dict[int, tuple[float, float]] = {}
    for threads in arguments.threads:
        warp_renderer.BLOCK_THREADS = threads
        drawn_by_threads[threads] = timed(draw, device, arguments)
    fastest = min(arguments.threads, key=drawn_by_threads.__getitem__)
    warp_renderer.BLOCK_THREADS, drawn = fastest, drawn_by_threads[fastest]
    free.append(free_memory(device))
    plain.close()
    seen_environment, step_seen = started(SeenLift(camera=camera))
    sensor = seen_environment.world.sensors["camera"]

    def see() -> None:
        step_seen()
        for channel in CHANNELS:
            sensor.image(channel)  # pyright: ignore[reportAttributeAccessIssue]

    seen = timed(see, device, arguments)
    seen_environment.close()
    world, pictures = (None if free[0] is None else (a - b) / num_envs / 1024 for a, b in itertools.pairwise(free))
    return {
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        "num_envs": num_envs,
        "size": size,
        "shadows": settings["shadows"],
        "drawn_frames_per_s": round(num_envs / drawn[0]),
        "drawn_by_threads": {threads: round(num_envs / found[0]) for threads, found in drawn_by_threads.items()},
        "stepped_env_steps_per_s": round(num_envs / stepped[0]),
        "seen_env_steps_per_s": round(num_envs / seen[0]),
        "spread": [round(rate[1], 2) for rate in (drawn, stepped, seen)],
        "world_KiB_per_env": world,
        "pictures_KiB_per_env": pictures,
    }


def drawing(environment: Environment, camera: CameraSpec, settings: dict[str, bool]) -> Callable[[], object]:
    """The function that draws all environments as they are."""
    backend = backends.backend("warp")
    world = environment.world
    renderer = backend.create_renderer(world.layout, (camera,), backends.backend_config(backend, settings))
    pose = torch.tensor([(*camera.pose.position, *camera.pose.orientation)], device=environment.device)
    poses = pose.expand(environment.num_envs, -1).contiguous()
    return lambda: renderer.render(camera, poses, world.engine.link_poses, CHANNELS)


def timed(action: Callable[[], object], device: torch.device, arguments: argparse.Namespace) -> tuple[float, float]:
    """Median seconds of one, and the slowest block over the fastest; kernels are compiled before."""
    times: list[float] = []
    for _ in range(min(arguments.frames, 10)):
        action()
    for _ in range(arguments.blocks):
        wait(device)
        begun = time.perf_counter()
        for _ in range(arguments.frames):
            action()
        wait(device)
        times.append((time.perf_counter() - begun) / arguments.frames)
    return statistics.median(times), max(times) / min(times)


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def free_memory(device: torch.device) -> int | None:
    """Bytes; None on a CPU."""
    if device.type != "cuda":
        return None
    torch.cuda.synchronize(device)
    return torch.cuda.mem_get_info(device)[0]


def print_table(rows: list[dict[str, object]]) -> None:
    names = [name for name in rows[0] if name not in ("device", "spread", "drawn_by_threads")]
    print(rows[0]["device"], file=sys.stderr)
    for row in [{name: name for name in names}, *rows]:
        cells = [f"{row[name]:.1f}" if isinstance(row[name], float) else str(row[name]) for name in names]
        print(" | ".join(cell.rjust(len(name)) for cell, name in zip(cells, names, strict=True)), flush=True)


if __name__ == "__main__":
    main()
