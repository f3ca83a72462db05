"""Tries what PyTorch itself offers to capture a step with Warp's launches in it, beside what ORBIT does.

    python3 plugins/orbit-warp/benchmarks/gpu/torch_capture.py --num-envs 4096

Each way runs the traced step of Lift, engine and resets with it, and is timed where it works: ``torch.cuda.graph``
around the step, on a stream that Warp shares, with each of its error modes; and ``torch.compile`` of the step as Python
wrote it.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import torch
import warp as wp
from torch import Tensor

from orbit_core.envs import make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import CaptureFacet
from orbit_core.interfaces.capture import EngineCall, Traceable, traced_by


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    print(json.dumps({"torch": torch.__version__, "warp": wp.config.version}), flush=True)
    ways: dict[str, Callable[[argparse.Namespace], Callable[[], object]]] = {
        "orbit: Warp records Torch": recorded_by_warp,
        "orbit: the same, compiled": recorded_compiled,
        "traced, not recorded": issued_one_by_one,
        "torch.cuda.graph, global": lambda a: recorded_by_torch(a, "global"),
        "torch.cuda.graph, thread_local": lambda a: recorded_by_torch(a, "thread_local"),
        "torch.cuda.graph, relaxed": lambda a: recorded_by_torch(a, "relaxed"),
        "torch.compile of the whole step": lambda a: compiled_whole(a, None),
        "torch.compile, reduce-overhead": lambda a: compiled_whole(a, "reduce-overhead"),
    }
    for name, way in ways.items():
        print(json.dumps({"way": name, **tried(way, arguments)}), flush=True)


def tried(way: Callable[[argparse.Namespace], Callable[[], object]], arguments: argparse.Namespace) -> dict[str, Any]:
    """Milliseconds of a step, or why there are none."""
    begun = time.perf_counter()
    try:
        step = way(arguments)
        for _ in range(10):
            step()
        _wait()
        ready = time.perf_counter() - begun
        times = [_timed(step, arguments.steps) for _ in range(3)]
    except Exception as error:  # whatever Torch, Warp or the driver cannot do is the answer
        return {"works": False, "why": f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"}
    return {"works": True, "ms": round(1e3 * statistics.median(times), 4), "ready_s": round(ready, 1)}


def recorded_by_warp(arguments: argparse.Namespace) -> Callable[[], object]:
    """Record a step as environments do."""
    return _stepping(_environment(arguments))


def recorded_compiled(arguments: argparse.Namespace) -> Callable[[], object]:
    """Record a compiled step as environments do with ``compile=True``."""
    return _stepping(_environment(arguments, compile=True))


def issued_one_by_one(arguments: argparse.Namespace) -> Callable[[], object]:
    """The trace without a recording of it; the engine's own stays one."""
    environment = _environment(arguments)
    environment.world.engine.capture = _Unrecorded(environment.world.engine.capture)
    return _stepping(environment)


def recorded_by_torch(arguments: argparse.Namespace, mode: str) -> Callable[[], object]:
    """The trace, recorded by Torch on a stream of its own, with Warp's launches on the same stream."""
    environment = _environment(arguments)
    environment.world.engine.capture = _Unrecorded(environment.world.engine.capture)
    step = _stepping(environment)
    step(), step()
    assert environment._closed is not None
    (part,) = environment._closed.parts
    function, _ = next(iter(part._known.values()))
    trace = function.replay
    assert trace is not None
    stream, graph = torch.cuda.Stream(), torch.cuda.CUDAGraph()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream), wp.ScopedStream(wp.stream_from_torch(stream), sync_enter=False):
        for _ in range(3):
            trace()
        stream.synchronize()
        with torch.cuda.graph(graph, stream=stream, pool=torch.cuda.graph_pool_handle(), capture_error_mode=mode):
            trace()
    before = environment.world.engine.joint_positions.clone()
    graph.replay()
    _wait()
    if torch.equal(before, environment.world.engine.joint_positions):
        raise RuntimeError("the graph holds none of Warp's launches: nothing moved")
    return graph.replay


def compiled_whole(arguments: argparse.Namespace, mode: str | None) -> Callable[[], object]:
    """Python's own step, resets by mask with it, in the hands of torch.compile."""
    environment = _environment(arguments)
    environment._closed = None
    environment.step(torch.zeros_like(environment._action))
    whole = CapturedStep(environment, compile=False, whole=True)._play_and_renew

    def play() -> object:
        environment.observe()
        with traced_by(_PassThrough()):
            return whole()

    return torch.compile(play, mode=mode)


class _PassThrough:
    """Tracer that notes nothing: code then looks at no numbers, as in a traced step."""

    incomplete = False

    def read(self, owner: Traceable, name: str, function: Callable[[], Tensor]) -> Tensor:
        return function()

    def call(self, call: EngineCall) -> Any:
        return call.function(**call.arguments)


class _Unrecorded(CaptureFacet):
    """An engine's facet, but for its recordings."""

    def __init__(self, own: CaptureFacet) -> None:
        self._own = own
        self.takes_masks = own.takes_masks  # pyright: ignore[reportAttributeAccessIssue]

    def expression(self, name: str) -> torch.Tensor | None:
        return self._own.expression(name)

    def settle(self) -> None:
        self._own.settle()


def _environment(arguments: argparse.Namespace, compile: bool = False) -> Environment:
    fields = {"action": "ik_relative"}
    environment = make("Lift", arguments.num_envs, "warp", arguments.device, compile=compile, **fields)
    environment.reset(seed=0)
    return environment


def _stepping(environment: Environment) -> Callable[[], object]:
    action = 2.0 * torch.rand_like(environment._action) - 1.0
    return lambda: environment.step(action)


def _timed(step: Callable[[], object], steps: int) -> float:
    _wait()
    begun = time.perf_counter()
    for _ in range(steps):
        step()
    _wait()
    return (time.perf_counter() - begun) / steps


def _wait() -> None:
    if torch.cuda.is_available():
        torch.cuda.synchronize()


if __name__ == "__main__":
    main()
