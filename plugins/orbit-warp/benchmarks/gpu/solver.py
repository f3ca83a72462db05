"""Compares the solver in one launch with MuJoCo-Warp's own, on the same constraints: results, rounds and time.

    python plugins/orbit-warp/benchmarks/gpu/solver.py --task Lift --policy lift

Each line is one state of all environments, after more steps of random actions or of a policy's. ``apart`` are largest
differences of an environment, relative to its largest number; ``worlds_off`` counts those of more than 1e-3 in
acceleration; microseconds are of one solve, replayed from a graph, at the warm start of the state.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportPrivateUsage=false

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import mujoco_warp as mjw
import torch
import warp as wp
from bench import actor_of, fields_of
from mujoco_warp._src import solver

from orbit_core.envs import make
from orbit_warp import solver_kernel
from orbit_warp.fused_solver import FusedSolver, is_fit

_KEPT = ("qacc", "qfrc_constraint", "solver_niter", "overflow")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="Lift")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--action")
    parser.add_argument("--robot")
    parser.add_argument("--policy")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--steps", type=int, default=40, help="environment steps between two states")
    parser.add_argument("--states", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=20, help="solves of one recording")
    parser.add_argument("--cone", default="elliptic")
    parser.add_argument("--resident", type=int, nargs="+", default=[], help="other bounds of worlds per multiprocessor")
    arguments = parser.parse_args()
    settings = {"cone": arguments.cone}
    environment = make(
        arguments.task, num_envs=arguments.num_envs, backend="warp", device=arguments.device, settings=settings,
        reset_diverged=True, **fields_of(arguments),
    )  # fmt: skip
    environment.reset(seed=0)
    environment.state.episode_step.random_(environment.max_episode_steps)
    act, engine = actor_of(arguments, environment), environment.world.engine
    native = engine.native  # pyright: ignore[reportOptionalMemberAccess]
    model, data = native.model, native.data
    assert is_fit(model, data)
    with wp.ScopedDevice(engine._graphs.device):
        ways = {"fused": FusedSolver(model, data)}
        for resident in arguments.resident:
            ways[f"fused, {resident} resident"] = _bounded(model, data, resident)
    for state in range(arguments.states):
        for k in range(arguments.steps):
            environment.step(act(k))
        with wp.ScopedDevice(engine._graphs.device):
            line = compare(model, data, ways, arguments.repeats)
        print(json.dumps({"task": arguments.task, "policy": arguments.policy, "state": state} | line), flush=True)
    environment.close()


def _bounded(model: mjw.Model, data: mjw.Data, resident: int) -> FusedSolver:
    kept, solver_kernel._BLOCKS = solver_kernel._BLOCKS, resident
    solver_kernel.solver_kernel.cache_clear()
    try:
        return FusedSolver(model, data)
    finally:
        solver_kernel._BLOCKS = kept
        solver_kernel.solver_kernel.cache_clear()


def compare(model: mjw.Model, data: mjw.Data, ways: dict[str, FusedSolver], repeats: int) -> dict[str, object]:
    """Solve the present state's constraints in each way."""
    mjw.forward(model, data)
    solver.solve(model, data)
    theirs = _read(data)
    rounds = theirs["solver_niter"].float()
    result: dict[str, object] = {
        "rows": [int(data.nefc.numpy().min()), int(data.nefc.numpy().max())],
        "rounds": {"mean": round(float(rounds.mean()), 2), "most": int(rounds.max())},
        "microseconds": {"stock": _microseconds(lambda: solver.solve(model, data), repeats)},
    }
    for name, way in ways.items():
        for array in (data.qacc, data.qfrc_constraint, data.efc.force, data.efc.Ma):
            array.fill_(123.0)
        way.solve(model, data)
        mine = _read(data)
        apart = {
            key: float(((mine[key] - theirs[key]).abs().amax(1) / (theirs[key].abs().amax(1) + 1e-3)).max())
            for key in ("qacc", "qfrc_constraint", "force")
        }
        off = (mine["qacc"] - theirs["qacc"]).abs().amax(1) > 1e-3 * (theirs["qacc"].abs().amax(1) + 1e-3)
        difference = (mine["solver_niter"] - theirs["solver_niter"]).abs()
        result[name] = {
            "apart": {key: float(f"{value:.1e}") for key, value in apart.items()},
            "worlds_off": int(off.sum()),
            "rounds_differ": int((difference > 0).sum()),
            "rounds_differ_by": int(difference.max()),
            "states_differ": int((mine["state"] != theirs["state"]).sum()),
            "overflow_differs": int((mine["overflow"] != theirs["overflow"]).sum()),
        }
        result["microseconds"][name] = _microseconds(lambda way=way: way.solve(model, data), repeats)  # pyright: ignore[reportIndexIssue]
    return result


def _read(data: mjw.Data) -> dict[str, torch.Tensor]:
    found = {name: wp.to_torch(getattr(data, name)).clone() for name in _KEPT}
    for name in ("force", "state"):
        rows = wp.to_torch(getattr(data.efc, name))
        used = torch.arange(rows.shape[1], device=rows.device) < wp.to_torch(data.nefc)[:, None]
        found[name] = torch.where(used, rows, 0)
    return found


def _microseconds(launch: Callable[[], None], repeats: int) -> float:
    def run() -> None:
        for _ in range(repeats):
            launch()

    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as capture:
            run()
        graph = capture.graph
        wp.capture_launch(graph)
    else:
        graph = None
    wp.synchronize()
    begun = time.perf_counter()
    wp.capture_launch(graph) if graph is not None else run()
    wp.synchronize()
    return round(1e6 * (time.perf_counter() - begun) / repeats, 1)


if __name__ == "__main__":
    main()
