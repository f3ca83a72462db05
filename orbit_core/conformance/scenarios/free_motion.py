"""Bodies that nothing touches."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from orbit_core.conformance.bodies import G, cube, scene
from orbit_core.conformance.scenario import Metric, Scenario, Trial
from orbit_core.scene import Pose


def _free_fall(trial: Trial) -> Mapping[str, float]:
    height = 10.0
    world = trial.world(scene(cube(pose=Pose((0.0, 0.0, height))), terrain=()))
    body = world.objects["cube"]
    times, heights, speeds = [0.0], [height], [0.0]
    for count in range(1, 11):
        trial.step(world, trial.steps(0.1))
        times.append(0.1 * count)
        heights.append(body.root_pose[0, 2].item())
        speeds.append(body.root_velocity[0, 2].item())
    time = torch.tensor(times)
    truth = height - 0.5 * G * time**2
    trial.trace("height", "m", times, heights, truth.tolist())
    return {
        "position": float((torch.tensor(heights) - truth).abs().max()),
        "velocity": float((torch.tensor(speeds) + G * time).abs().max()),
    }


SCENARIOS = (
    Scenario(
        name="free_fall",
        group="Free motion",
        question="Does a body fall as Galileo says?",
        truth="z = h - g t^2 / 2, v = -g t",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.1",
        run=_free_fall,
        metrics=(
            Metric(
                name="position",
                unit="m",
                tolerance=0.026,
                meaning="largest distance from the parabola within one second",
                looser_because="integrators of first order err by g t dt / 2",
            ),
            Metric(name="velocity", unit="m/s", tolerance=1e-4, meaning="largest distance from -g t within one second"),
        ),
    ),
)
