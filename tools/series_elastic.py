"""A known series-elastic actuator, and recordings of it: what ``orbit train-actuator`` is shown on.

A motor, seen through its gear, turns one end of a spring; the other end turns the joint (Pratt and Williamson, Series
Elastic Actuators, 1995). The drive's controller asks the spring for ``80 (target - position) - 2 velocity``, and the
motor for that and more by the spring's own error; the motor has inertia, viscous and dry friction, and an effort limit.
The joint carries a pendulum that is pushed now and then. Only the joint and the spring's effort are recorded.

    python tools/series_elastic.py out/spring.npz
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

SPRING, SPRING_DAMPING = 300.0, 0.5  # N m/rad, N m s/rad
MOTOR_INERTIA, VISCOUS, DRY = 0.08, 1.5, 2.0  # kg m^2, N m s/rad, N m
MOTOR_LIMIT = 45.0  # N m
FORCE_GAIN, FORCE_DAMPING = 2.0, 4.0
LOAD_INERTIA, LOAD_MOMENT = 0.4, 6.0  # kg m^2, N m


def record(seconds: float, rate: float = 200.0, joints: int = 4, seed: int = 0) -> dict[str, np.ndarray]:
    """Joints that follow targets of their own, as :mod:`orbit_learn.actuators.recordings` describes a recording."""
    random = np.random.default_rng(seed)
    fine = 20  # steps of the simulation in one that is recorded
    dt = 1.0 / (rate * fine)
    steps = round(seconds * rate)
    position, velocity, motor, motor_velocity = np.zeros((4, joints))
    frequency = random.uniform(0.3, 4.0, (joints, 4))
    phase = random.uniform(0.0, 2.0 * np.pi, (joints, 4))
    size = random.uniform(0.05, 0.25, (joints, 4))
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("position_target", "position", "velocity", "effort")}
    push, held = np.zeros(joints), np.zeros(joints)
    for step in range(steps):
        now = step / rate
        if step % 40 == 0:
            push = np.where(random.random(joints) < 0.3, random.normal(0.0, 12.0, joints), 0.0)
            held = np.where(random.random(joints) < 0.2, random.normal(0.0, 0.2, joints), held)
        target = held + (size * np.sin(2.0 * np.pi * frequency * now + phase)).sum(1)
        effort = np.zeros(joints)
        for _ in range(fine):
            effort = SPRING * (motor - position) + SPRING_DAMPING * (motor_velocity - velocity)
            asked = 80.0 * (target - position) - 2.0 * velocity
            drive = asked + FORCE_GAIN * (asked - effort) - FORCE_DAMPING * (motor_velocity - velocity)
            drive = np.clip(drive, -MOTOR_LIMIT, MOTOR_LIMIT)
            friction = VISCOUS * motor_velocity + DRY * np.tanh(motor_velocity / 0.05)
            motor_velocity = motor_velocity + dt * (drive - friction - effort) / MOTOR_INERTIA
            load = effort + push - LOAD_MOMENT * np.sin(position) - 0.3 * velocity
            velocity = velocity + dt * load / LOAD_INERTIA
            motor, position = motor + dt * motor_velocity, position + dt * velocity
        for name, value in zip(rows, (target, position, velocity, effort), strict=True):
            rows[name].append(value.copy())
    names = np.array([f"joint_{i}" for i in range(joints)])
    return {"time": np.arange(steps) / rate, "joints": names, **{name: np.array(row) for name, row in rows.items()}}


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **record(seconds=120.0))  # pyright: ignore[reportArgumentType]
    print(f"two minutes of four joints at 200 Hz are in {path}")
