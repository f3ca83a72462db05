"""Measures the renderer: pictures a second of each tier, and how long the first takes.

    PYTHONPATH=$PWD:$PWD/plugins/orbit-sapien python3 plugins/orbit-sapien/benchmarks/gpu/cameras.py --json cameras.json

Draws 24 boxes and balls that lie still, from poses alone; a picture is one environment's, copied to the host. Each row
draws all environments again and again for ``--seconds``, at least once. Rates are those of the best round, with the
median beside it: other programs only slow a machine down. The processor's time a picture does not depend on them; on a
CPU's driver it is all of the work. The first picture includes making the renderer.

Needs torch, numpy and these packages with none of their other dependencies, so that a machine without a registry can be
given them: sapien requests urllib3 idna certifi charset-normalizer transforms3d tqdm importlib_metadata lazy-importer
zipp.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from orbit_core import backends
from orbit_core.interfaces import OrbitError, SceneLayout
from orbit_core.scene import (
    Box,
    CameraSpec,
    Channel,
    ObjectSpec,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
    look_at,
    single_link,
)
from orbit_sapien.backend import SapienFast, SapienPbr, SapienRt

SIZES = (84, 256)
SAMPLES = (1, 8, 64)
DENOISERS = ("none", "oidn")
TIERS = {"fast": SapienFast, "pbr": SapienPbr, "rt": SapienRt}
MEASURED = (Channel.DEPTH, Channel.NORMALS, Channel.ALBEDO, Channel.INSTANCE)


@dataclass(frozen=True)
class Row:
    """The measurement of one setting at one size."""

    tier: str
    settings: str
    size: int
    first_s: float | None = None
    best_per_s: float | None = None
    median_per_s: float | None = None
    cpu_s: float | None = None
    """The process's own time on all cores, a picture."""
    rounds: int = 0
    failure: str = ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, default=16, help="pictures of a round")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each row, at least one round")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="pixels along a side")
    parser.add_argument("--samples", type=int, nargs="+", default=SAMPLES, help="of tier rt, a pixel")
    parser.add_argument("--denoisers", nargs="+", default=DENOISERS, help="of tier rt; all but 'none' need a GPU")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{'tier':5} {'settings':32} {'size':>4} {'first, s':>9} {'best /s':>9} {'median /s':>9} {'CPU, ms':>9} rounds"
    )
    rows: list[Row] = []
    for tier, settings, channels in settings_of(arguments):
        for size in arguments.sizes:
            rows.append(measure(tier, settings, channels, size, arguments))
            print(line(rows[-1]), flush=True)
            if arguments.json:  # after each row, for a run that is cut off
                arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def settings_of(arguments: argparse.Namespace) -> Iterator[tuple[str, dict[str, int | str], tuple[Channel, ...]]]:
    yield "fast", {}, (Channel.RGB,)
    yield "fast", {}, MEASURED
    yield "pbr", {}, (Channel.RGB,)
    for samples in arguments.samples:
        for denoiser in arguments.denoisers:
            yield "rt", {"samples_per_pixel": samples, "denoiser": denoiser}, (Channel.RGB,)


def measure(
    tier: str, settings: dict[str, int | str], channels: tuple[Channel, ...], size: int, arguments: argparse.Namespace
) -> Row:
    words = ", ".join(map(str, settings.values())) or ("measured" if channels == MEASURED else "colour")
    camera = CameraSpec(name="camera", width=size, height=size, pose=look_at((1.6, -1.2, 1.1), (0.0, 0.0, 0.2)))
    layout = SceneLayout.of(shapes())
    plugin = TIERS[tier]()
    links = torch.tensor([[*entity.spec.pose.position, 1.0, 0.0, 0.0, 0.0] for entity in layout.entities])
    links = links.expand(arguments.num_envs, -1, 7)
    eyes = torch.tensor([[*camera.pose.position, *camera.pose.orientation]]).expand(arguments.num_envs, 7)
    try:
        begun = time.perf_counter()
        renderer = plugin.create_renderer(layout, (camera,), backends.backend_config(plugin, settings))
        renderer.render(camera, eyes[:1], links[:1], channels)
        first = time.perf_counter() - begun
        busy = time.process_time()
        times = timed(lambda: renderer.render(camera, eyes, links, channels), arguments.seconds)
        busy = (time.process_time() - busy) / (len(times) * arguments.num_envs)
        renderer.close()
    except (OrbitError, RuntimeError) as error:
        return Row(tier, words, size, failure=str(error))
    best, median = (round(arguments.num_envs / taken, 2) for taken in (min(times), statistics.median(times)))
    return Row(tier, words, size, round(first, 3), best, median, round(busy, 5), len(times))


def timed(draw, seconds: float) -> list[float]:
    """Seconds of each round."""
    times: list[float] = []
    while sum(times) < seconds:
        begun = time.perf_counter()
        draw()
        times.append(time.perf_counter() - begun)
    return times


def shapes() -> Scene:
    """Boxes and balls on a ground."""
    random = np.random.default_rng(0)
    things = []
    for number in range(24):
        size, color = random.uniform(0.04, 0.12), (*random.uniform(0.1, 0.9, 3), 1.0)
        shape = Shape(Box((size, size, size)) if number % 2 else Sphere(size), color=color)
        place = Pose((*random.uniform(-0.7, 0.7, 2), size))
        body = single_link(f"thing{number}", shape, 1.0, np.eye(3) * 0.01)
        things.append(ObjectSpec(name=f"thing{number}", articulation=body, pose=place))
    return Scene(objects=tuple(things), terrain=(Shape(Plane(), color=(0.5, 0.5, 0.45, 1.0)),))


def line(row: Row) -> str:
    if row.failure:
        return f"{row.tier:5} {row.settings:32} {row.size:4} failed: {row.failure}"
    figures = (
        f"{row.first_s:9.2f} {row.best_per_s:9.2f} {row.median_per_s:9.2f} {1e3 * (row.cpu_s or 0):9.2f} {row.rounds:6}"
    )
    return f"{row.tier:5} {row.settings:32} {row.size:4} {figures}"


if __name__ == "__main__":
    sys.exit(main())
