"""Measures physics steps with a cup of liquid in each environment: engine and matter together.

    python plugins/orbit-matter/benchmarks/fluid.py --backend warp --num-envs 64 1024

Each line is one size: environment steps per second, the median over blocks, of 20 ms each; seconds until the first step
was done, kernels compiled; memory of the device that an environment takes. For a whole task, see ``speed.py``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time

import torch

from orbit_assets.deformables import open_box
from orbit_core.interfaces import World
from orbit_core.scene import Fluid, Pose, Scene
from orbit_core.world import simulate

SUBSTEPS = 8
"""Physics steps of 2.5 ms in an environment step."""
SIDE = 0.06
"""Metres of the cube of liquid: 1,000 particles at a spacing of 6 mm."""
G, DENSITY = 9.81, 1000.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, nargs="+", default=[1024])
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--spacing", type=float, default=0.006, help="metres between particles")
    parser.add_argument("--steps", type=int, default=50, help="environment steps of a block")
    parser.add_argument("--blocks", type=int, default=5)
    arguments = parser.parse_args()
    for num_envs in arguments.num_envs:
        print(json.dumps(measure(arguments, num_envs)), flush=True)


def measure(arguments: argparse.Namespace, num_envs: int) -> dict[str, object]:
    """Measure one number of environments."""
    free, begun = _free(arguments.device), time.perf_counter()
    half = 0.5 * SIDE
    water = Fluid("water", (half, half, half), DENSITY, Pose((0.0, 0.0, half)), spacing=arguments.spacing)
    cup = open_box("cup", (SIDE, SIDE, 0.08), Pose())
    # No ground: it would carry the liquid beside the cup, whose floor is at its height.
    scene = Scene(objects=(cup,), deformables=(water,), terrain=(), physics_dt=0.0025)
    world = simulate(scene, num_envs, arguments.backend, device=arguments.device, matter="orbit-matter")
    world.step(1)
    _wait(world)
    ready = time.perf_counter() - begun
    world.step(200)
    blocks = [_seconds(world, arguments.steps) for _ in range(arguments.blocks)]
    taken = free - _free(arguments.device)
    particles = world.deformables["water"].positions.shape[1]
    felt = -world.deformables["water"].contact_force("cup", "cup")[0, 2].item()
    world.close()
    return {
        "num_envs": num_envs,
        "backend": arguments.backend,
        "device": torch.cuda.get_device_name() if free else "cpu",
        "particles": particles,
        "env_steps_per_s": round(num_envs * arguments.steps / statistics.median(blocks)),
        "blocks_per_s": [round(num_envs * arguments.steps / seconds) for seconds in blocks],
        "ready_s": round(ready, 1),
        "memory_KiB_an_environment": round(taken / 1024 / num_envs),
        "force_over_weight": round(felt / (G * DENSITY * particles * arguments.spacing**3), 3),
    }


def _seconds(world: World, steps: int) -> float:
    _wait(world)
    begun = time.perf_counter()
    world.step(SUBSTEPS * steps)
    _wait(world)
    return time.perf_counter() - begun


def _wait(world: World) -> None:
    if world.device.type == "cuda":
        torch.cuda.synchronize(world.device)


def _free(device: str) -> int:
    """Return the bytes of the device's memory that are free; 0 on a CPU."""
    return torch.cuda.mem_get_info(device)[0] if device.startswith("cuda") else 0


if __name__ == "__main__":
    main()
