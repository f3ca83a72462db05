"""Measures Newton's own deformables, VBD and implicit MPM, in the set-ups of the conformance scenarios of matter.

    python plugins/orbit-newton/benchmarks/deformables.py
    python plugins/orbit-newton/benchmarks/deformables.py --device cuda:0 --json newton_deformables.jsonl

It needs Newton (``pip install "newton[sim]" mujoco==3.17.0 scipy``) and nothing of ORBIT: dimensions, materials and
tolerances are those of ``tests/conformance/orbit_conformance/scenarios``. Each line is one figure: what was found, what
is true, the error and the scenario's tolerance of it, and milliseconds for a physics step of 5 ms. Cases come in the
order of what they tell, each ends at its own limit of time, and ``--json`` appends each line as it is found. Newton
compiles its kernels in the first case of each solver, for minutes: keep ``WARP_CACHE_PATH``.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Iterator
from pathlib import Path

import deformables_mpm
import deformables_vbd
import warp as wp
from deformables_figures import Budget, Case, Figure, OutOfTime


def main() -> None:
    """Run the cases that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="Warp's name of it, as cuda:0")
    parser.add_argument("--cases", nargs="*", default=[], help="parts of names of cases; all without")
    parser.add_argument(
        "--limit", type=float, default=60.0, help="seconds for a case, without those until its first step"
    )
    parser.add_argument("--total", type=float, default=float("inf"), help="seconds after which no case begins")
    parser.add_argument("--json", type=Path, help="file that each figure is appended to")
    arguments = parser.parse_args()
    wp.config.quiet = True
    begun = time.perf_counter()
    gpu = wp.get_device(arguments.device).is_cuda
    print(f"{'case':<46} {'figure':<14} {'found':>10} {'true':>10} {'error':>8} {'allowed':>8} {'ms':>8}", flush=True)
    for case in (*deformables_vbd.CASES, *deformables_mpm.CASES):
        chosen = any(part in case.name for part in arguments.cases) or not arguments.cases
        if not chosen or (case.large and not gpu) or time.perf_counter() - begun > arguments.total:
            continue
        for figure in _figures(case, arguments.device, arguments.limit):
            print(_line(case, figure), flush=True)
            if arguments.json:
                entry = {"case": case.name, "device": arguments.device, **dataclasses.asdict(figure)}
                with arguments.json.open("a") as file:
                    file.write(json.dumps(entry) + "\n")


def _figures(case: Case, device: str, limit: float) -> Iterator[Figure]:
    """Figures of a case as they are found, and one that tells why there are no more."""
    budget = Budget(limit, gpu=wp.get_device(device).is_cuda)
    try:
        with wp.ScopedDevice(device):
            yield from case.run(device, budget)
    except OutOfTime as error:
        yield Figure("time", float("nan"), note=str(error), milliseconds=budget.milliseconds)
    except Exception as error:  # one case that fails must not end those after it
        yield Figure("failed", float("nan"), note=f"{type(error).__name__}: {error}"[:300])


def _line(case: Case, figure: Figure) -> str:
    verdict = "" if figure.tolerance is None else " passes" if figure.passes else " FAILS"
    allowed = "" if figure.tolerance is None else f"{figure.tolerance:.4g}"
    true = "" if figure.true is None else f"{figure.true:.4g}"
    error = "" if figure.error is None else f"{figure.error:+.4f}"
    row = f"{case.name:<46} {figure.name:<14} {figure.found:>10.4g} {true:>10} {error:>8} {allowed:>8}"
    return f"{row} {figure.milliseconds:>8.1f}{verdict} {figure.note}"


if __name__ == "__main__":
    main()
