"""A forked process may not use its parent's worlds, and is told so; the parent goes on."""

from __future__ import annotations

import subprocess
import sys

import pytest

_CODE = """
import multiprocessing, os, sys, warnings
import torch
from orbit_core.interfaces import ClosedError
from orbit_core.envs import make

warnings.simplefilter("ignore")  # Python's own about threads
settings = {"workers": 2} if sys.argv[1] == "bullet" else {}
environment = make("Reach", num_envs=2, backend=sys.argv[1], settings=settings)
environment.reset()
action = torch.zeros(2, environment.action_size)

def child():
    uses = [
        lambda: environment.step(action), lambda: environment.world.step(), lambda: environment.world.save_state(),
        lambda: next(iter(environment.world.robots.values())).joint_positions, lambda: environment.reset(),
    ]
    for use in uses:
        try:
            use()
            print("used")
        except ClosedError as error:
            print(error)
    environment.close()

worker = multiprocessing.get_context("fork").Process(target=child)
worker.start()
worker.join(60)
print("ended", worker.exitcode, flush=True)
if os.fork() == 0:
    sys.exit(0)  # as programs end, with all that they do then
os.wait()
environment.step(action)
environment.reset()
environment.close()
print("the parent went on")
"""


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_a_forked_process_may_not_use_a_world(backend: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _CODE, backend], capture_output=True, text=True, timeout=120, check=False
    )
    lines = done.stdout.splitlines()
    refused = [line for line in lines if line.startswith("the world was made by process")]
    assert len(refused) == 5, done.stdout + done.stderr
    assert "spawn" in refused[0]
    assert lines[-2:] == ["ended 0", "the parent went on"], done.stderr
    assert "Traceback" not in done.stderr


_CLOSED = """
import os, sys
from orbit_core.scene import Scene
from orbit_core.world import simulate
world = simulate(Scene(), num_envs=1, backend=sys.argv[1])
world.close()
child = os.fork()
if not child:
    os._exit(0)
os.waitpid(child, 0)
"""


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_a_closed_world_is_left_in_silence(backend: str) -> None:
    # A processor for which MKL has no mode of equal products is told of when a world begins, not at its end.
    words = [sys.executable, "-W", "ignore:matrix products", "-c", _CLOSED, backend]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")
