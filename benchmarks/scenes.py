"""Time procedural houses, kitchens and small pictures drawn in software.

    python benchmarks/scenes.py [--backend mujoco] [--seconds 5]

Prints seconds to make and to build a house of five rooms with 40 things, environment steps a second of 64 kitchens with
10 things each, and environment steps a second of Lift with a colour camera of 84 x 84 pixels.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from orbit_core.envs import make
from orbit_core.envs.actors import scripted_actor
from orbit_core.mdp.sensing import with_cameras
from orbit_core.world import simulate
from orbit_scenes.house import make_house, room_kinds
from orbit_tasks.lift import Lift

# Seconds of a step of a kitchen.
STEP = 0.02


def main() -> None:
    """Measure and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement of a rate")
    settings = parser.parse_args()
    print("| what | figure |\n|---|---|")
    for row in (*house(settings.backend), kitchens(settings), pictures(settings)):
        print(f"| {row} |", flush=True)


def house(backend: str) -> tuple[str, str]:
    """Return rows of the seconds to make and to build a house."""
    start = time.perf_counter()
    scene = make_house(room_kinds("house", 5), seed=0, things=40).scene
    made = time.perf_counter()
    world = simulate(scene, 1, backend)
    built = time.perf_counter()
    world.close()
    return (
        f"a house of five rooms and 40 things, made | {made - start:.1f} s",
        f"built on {backend} | {built - made:.1f} s",
    )


def kitchens(settings: argparse.Namespace) -> str:
    """Return a row of the rate of 64 kitchens."""
    scene = make_house(room_kinds("kitchen", 1), seed=3, things=10).scene
    world = simulate(scene, 64, settings.backend)
    steps = round(STEP / scene.physics_dt)
    rate = 64 * calls_a_second(lambda: world.step(steps), settings.seconds)
    world.close()
    return f"64 kitchens with 10 things, steps of {1000.0 * STEP:.0f} ms | {rate:.0f} a second"


def pictures(settings: argparse.Namespace) -> str:
    """Return a row of the rate of Lift with a small camera."""
    task = Lift()
    with_cameras(task, {"front": (84, 84)})
    environment = make(task, num_envs=1, backend=settings.backend)
    actor = scripted_actor("hold", environment, 0)
    environment.reset(seed=0)
    rate = calls_a_second(lambda: environment.step(actor.act()), settings.seconds)
    environment.close()
    return f"Lift with colour pictures of 84 x 84 | {rate:.0f} steps a second"


def calls_a_second(call: Callable[[], object], seconds: float) -> float:
    """Return how often a function can be called a second, its first calls left out."""
    for _ in range(3):
        call()
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        call()
        count += 1
    return count / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
