"""Measures steps with sensors in them: a walker with rays, noise and delays, Lift with a camera, each recorded whole.

    python3 plugins/orbit-warp/benchmarks/gpu/sensors.py                  # walker at 4,096 environments, Lift at 1,024
    python3 plugins/orbit-warp/benchmarks/gpu/sensors.py --only walker --no-compile

``walker``: Velocity-Flat with a height scan of 187 rays, an IMU and joint encoders, all at 50 Hz, noisy, the last two
20 ms late. ``ratio`` is (the engine alone + its rays alone) over the whole step: the engine's own captured stepping
from the state that a block began in and by the very commands that the environment gave, and the engine's own cast of
that many rays. ``camera``: Lift with a colour and depth picture of 64 x 64 in each step. ``ratio`` is (Lift's step
without a camera + drawing alone) over the step with the camera. Rates are medians over blocks; ``recorded`` says
whether the step ran without its Python.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch

from orbit_core import backends
from orbit_core.envs import ObservationGroup, ObservationTerm, make
from orbit_core.envs.environment import Environment
from orbit_core.envs.task import Task
from orbit_core.mdp.sensing import camera_color, camera_depth
from orbit_core.scene import (
    CameraSpec,
    Channel,
    ImuSpec,
    JointSensorSpec,
    Noise,
    Pose,
    RayCasterSpec,
    Scene,
    look_at,
)
from orbit_core.sensors.rays import grid_pattern
from orbit_tasks.lift import Lift
from orbit_tasks.velocity_flat import VelocityFlat
from orbit_warp.native_baseline import raw_steppers

_ORIGINS, _DIRECTIONS = grid_pattern((1.6, 1.0), 0.1)
_NOISE = Noise(std=0.01, bias_std=0.01)
_LATE = {"rate": 50.0, "delay": 0.02, "noise": _NOISE}
SCAN = RayCasterSpec(
    name="scan", entity="robot", frame="base", rate=50.0, noise=_NOISE, yaw_only=True,
    origins=_ORIGINS, directions=_DIRECTIONS, pose=Pose((0.0, 0.0, 0.5)), max_distance=5.0,
)  # fmt: skip
IMU = ImuSpec(name="imu", entity="robot", frame="base", **_LATE)  # pyright: ignore[reportArgumentType]
ENCODERS = JointSensorSpec(name="encoders", entity="robot", **_LATE)  # pyright: ignore[reportArgumentType]
CAMERA = CameraSpec(
    name="camera", width=64, height=64, channels=(Channel.RGB, Channel.DEPTH),
    pose=look_at((1.3, -0.6, 0.8), (0.4, 0.0, 0.1)),
)  # fmt: skip


def _term(name: str, *values: str) -> ObservationTerm:
    def read(env: Environment) -> torch.Tensor:
        return torch.cat([getattr(env.world.sensors[name], value).clamp(-100.0, 5.0) for value in values], 1)

    return ObservationTerm(read)


@dataclass
class Sensed(ObservationGroup):
    """The measurements of the walker's sensors."""

    scan: ObservationTerm | None = _term("scan", "distances")
    imu: ObservationTerm | None = _term("imu", "angular_velocity", "linear_acceleration")
    encoders: ObservationTerm | None = _term("encoders", "positions", "velocities")


@dataclass
class SensedObservations:
    """One group."""

    policy: Sensed = field(default_factory=Sensed)


@dataclass(kw_only=True)
class SensingWalker(VelocityFlat):
    """Velocity-Flat by its sensors."""

    observations: SensedObservations = field(default_factory=SensedObservations)  # pyright: ignore

    def scene(self) -> Scene:
        scene = super().scene()
        return replace(scene, sensors=(*scene.sensors, SCAN, IMU, ENCODERS))


@dataclass
class Seen(ObservationGroup):
    """A picture."""

    concatenate: bool = False
    color: ObservationTerm | None = camera_color(CAMERA)
    depth: ObservationTerm | None = camera_depth(CAMERA)


@dataclass
class SeenObservations:
    """One group."""

    policy: Seen = field(default_factory=Seen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("walker", "camera"))
    parser.add_argument("--walkers", type=int, default=4096)
    parser.add_argument("--arms", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=100, help="environment steps of a block")
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--no-compile", action="store_true")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    if arguments.only != "camera":
        print(json.dumps(walker(arguments)), flush=True)
    if arguments.only != "walker":
        print(json.dumps(camera(arguments)), flush=True)


def walker(arguments: argparse.Namespace) -> dict[str, object]:
    """Rays, noise and delays."""
    environment, step = started(SensingWalker(), arguments.walkers, arguments)
    engine, decimation = environment.world.engine, environment.task.decimation
    (raw,) = raw_steppers(engine).values()  # pyright: ignore[reportArgumentType]
    raw.step(raw.command(), decimation)
    pose = engine.link_poses[:, 0, :3]
    origins = (pose[:, None] + torch.tensor(_ORIGINS, device=pose.device)).contiguous()
    directions = torch.tensor(_DIRECTIONS, device=pose.device).expand_as(origins).contiguous()
    links = environment.world.layout.entity("robot").links
    past = range(links.start, links.stop)
    casts: dict[str, Callable[[int], object]] = {
        "rays": lambda k: engine.cast_rays(origins, directions, SCAN.max_distance),
        "rays_past_the_robot": lambda k: engine.cast_rays_past(origins, directions, SCAN.max_distance, past),
    }
    commands: list[torch.Tensor] = []

    def noted(k: int) -> None:
        step(k)
        commands.append(raw.command())

    times: dict[str, list[float]] = {"whole": [], "alone": [], **{name: [] for name in casts}}
    for _ in range(arguments.blocks):
        raw.synchronize()
        commands.clear()
        times["whole"].append(timed(noted, arguments))
        times["alone"].append(timed(lambda k: raw.step(commands[k], decimation), arguments))
        for name, cast in casts.items():
            times[name].append(timed(cast, arguments))
    blocks = zip(times["whole"], times["alone"], times["rays"], strict=True)
    return {
        **report(environment, "Velocity-Flat, 187 rays, IMU, encoders", times),
        "ratio": round(statistics.median((alone + rays) / whole for whole, alone, rays in blocks), 3),
    }


def camera(arguments: argparse.Namespace) -> dict[str, object]:
    """Pictures of every step."""
    plain, step = started(Lift(), arguments.arms, arguments)
    times = {"step": [timed(step, arguments) for _ in range(arguments.blocks)]}
    backend, world = backends.backend("warp"), plain.world
    renderer = backend.create_renderer(world.layout, (CAMERA,), backends.backend_config(backend))
    pose = torch.tensor([(*CAMERA.pose.position, *CAMERA.pose.orientation)], device=plain.device)
    poses = pose.expand(plain.num_envs, -1).contiguous()

    def draw(k: int) -> None:
        renderer.render(CAMERA, poses, world.engine.link_poses, CAMERA.channels)

    draw(0)
    times["draw"] = [timed(draw, arguments) for _ in range(arguments.blocks)]
    renderer.close()
    plain.close()
    seen, step = started(Lift(observations=SeenObservations()), arguments.arms, arguments)  # pyright: ignore
    times["whole"] = [timed(step, arguments) for _ in range(arguments.blocks)]
    apart = statistics.median(times["step"]) + statistics.median(times["draw"])
    return {**report(seen, "Lift, 64 x 64", times), "ratio": round(apart / statistics.median(times["whole"]), 3)}


def started(task: Task, num_envs: int, arguments: argparse.Namespace) -> tuple[Environment, Callable[[int], object]]:
    """An environment whose step is ready, and its step by random actions."""
    environment = make(task, num_envs, "warp", arguments.device, compile=not arguments.no_compile)
    environment.reset(seed=0)
    environment.state.episode_step.random_(environment.max_episode_steps)
    shape = (16, num_envs, environment.action_size)
    actions = list(2.0 * torch.rand(shape, device=environment.device) - 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for action in actions:
            environment.step(action)
    return environment, lambda k: environment.step(actions[k % 16])


def timed(action: Callable[[int], object], arguments: argparse.Namespace) -> float:
    """Seconds of one."""
    wait()
    begun = time.perf_counter()
    for k in range(arguments.steps):
        action(k)
    wait()
    return (time.perf_counter() - begun) / arguments.steps


def wait() -> None:
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def report(environment: Environment, what: str, times: dict[str, list[float]]) -> dict[str, object]:
    """Milliseconds, and what they are of."""
    closed = environment._closed
    return {
        "what": what,
        "device": torch.cuda.get_device_name() if environment.device.type == "cuda" else "cpu",
        "num_envs": environment.num_envs,
        "recorded": closed is not None and not closed.refusal,
        "phases": [] if closed is None else [part.captured for part in closed.parts],
        "env_steps_per_s": round(environment.num_envs / statistics.median(times["whole"])),
        "ms": {name: round(1e3 * statistics.median(values), 4) for name, values in times.items()},
        "finite": bool(environment.world.engine.link_poses.isfinite().all()),
    }


if __name__ == "__main__":
    main()
