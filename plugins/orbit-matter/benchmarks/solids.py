"""Measures physics steps with one soft block in each environment, held by two fingers: engine and matter together.

    python plugins/orbit-matter/benchmarks/solids.py --backend warp --num-envs 64 1024 4096

Each line is one size: environment steps per second, the median over blocks, of 20 ms each; seconds until the first step
was done, kernels compiled; memory of the device that an environment takes. For a whole task, see ``speed.py``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time

import torch

from orbit_assets.deformables import cuboid
from orbit_conformance.scenarios.grasp import HALF, gripper
from orbit_core.interfaces import World
from orbit_core.scene import PhysicsMaterial, Pose, Scene, SoftBody
from orbit_core.world import simulate

SUBSTEPS = 8
"""Physics steps of 2.5 ms in an environment step."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, nargs="+", default=[1024])
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolution", type=float, help="metres of an element; half the block's edge by default")
    parser.add_argument("--iterations", type=int, default=6, help="of conjugate gradients in a step")
    parser.add_argument("--steps", type=int, default=50, help="environment steps of a block")
    parser.add_argument("--blocks", type=int, default=5)
    arguments = parser.parse_args()
    for num_envs in arguments.num_envs:
        print(json.dumps(measure(arguments, num_envs)), flush=True)


def measure(arguments: argparse.Namespace, num_envs: int) -> dict[str, object]:
    """Measure one number of environments."""
    free, begun = _free(arguments.device), time.perf_counter()
    mesh = cuboid((2.0 * HALF, 2.0 * HALF, 2.0 * HALF), (4, 4, 4))
    block = SoftBody("block", mesh, 500.0, Pose((0.0, 0.0, HALF)), 2e5, friction=1.0, resolution=arguments.resolution)
    hand = gripper(PhysicsMaterial(1.0, 1.0))
    scene = Scene(robots=(hand,), deformables=(block,), physics_dt=0.0025)
    settings = {"solid_iterations": arguments.iterations}
    world = simulate(
        scene, num_envs, arguments.backend, device=arguments.device, matter="orbit-matter", matter_settings=settings
    )
    force = torch.full((num_envs, 2), 5.0, device=world.device)
    world.robots["gripper"].set_effort_targets(force, [1, 2])
    world.step(1)
    _wait(world)
    ready = time.perf_counter() - begun
    world.step(200)
    blocks = [_seconds(world, arguments.steps) for _ in range(arguments.blocks)]
    taken = free - _free(arguments.device)
    felt = world.deformables["block"].contact_force("gripper", "left")[0, 1].item()
    world.close()
    return {
        "num_envs": num_envs,
        "backend": arguments.backend,
        "device": torch.cuda.get_device_name() if free else "cpu",
        "env_steps_per_s": round(num_envs * arguments.steps / statistics.median(blocks)),
        "blocks_per_s": [round(num_envs * arguments.steps / seconds) for seconds in blocks],
        "ready_s": round(ready, 1),
        "memory_KiB_an_environment": round(taken / 1024 / num_envs),
        "finger_feels_N": round(felt, 3),
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
