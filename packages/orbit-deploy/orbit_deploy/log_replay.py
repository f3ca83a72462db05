"""Recorded targets of a robot replayed in simulation, in many worlds at once that differ in their parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_assets.fitted import JOINT_QUANTITIES, FittedRobot
from orbit_core.backends import backend as backend_of
from orbit_core.interfaces import Capability, ConfigurationError, JointTarget, Robot, SimulationError, World
from orbit_core.scene import RobotSpec, Scene
from orbit_core.world import simulate
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_deploy.motion_log import MotionLog

# s between two rows that count as a gap: targets in between are unknown, and a busy computer pauses 0.1 s now and then
_GAP = 0.25


@dataclass(frozen=True)
class ParameterNames:
    """Meaning of a vector of parameters: quantities of joints, then those of the whole robot."""

    joints: tuple[str, ...]
    """Joints that are fitted."""
    quantities: tuple[str, ...]
    """Of :data:`~orbit_assets.fitted.JOINT_QUANTITIES`, in that order."""
    scalars: tuple[str, ...]
    """Of ``delay``, ``payload`` and ``gain``."""

    @property
    def all(self) -> tuple[str, ...]:
        """Names of the numbers: ``friction:joint1`` and so on, then the scalars."""
        return (*(f"{what}:{joint}" for what in self.quantities for joint in self.joints), *self.scalars)

    def column(self, name: str) -> int | None:
        """Return the place of a scalar, or None if it is not fitted."""
        return self.all.index(name) if name in self.scalars else None


class LogReplay:
    """Simulated robots that follow the targets of a log.

    Engines that can set joint parameters per environment run all candidates in one world; others get a world for each.

    Args:
        log: with the robot's joints in order.
        spec: robot, with a fixed base.
        backend: name of the physics backend.
        names: parameters that candidates differ in.
        payload_link: link that a payload is added to.
        dt: seconds of a physics step; the robot's own cycle if None.
        lead: longest delay of a candidate, s. The simulation begins this long after the log, where every delayed
            target is known, and takes the rows before from the log.
        settings: of the backend, by field name.

    Raises:
        ConfigurationError: the base is not fixed, or the backend cannot set what is fitted.
    """

    def __init__(
        self,
        log: MotionLog,
        spec: RobotSpec,
        backend: str,
        names: ParameterNames,
        payload_link: str = "",
        dt: float | None = None,
        lead: float = 0.0,
        settings: dict[str, object] | None = None,
    ) -> None:
        if not spec.fixed_base:
            raise ConfigurationError(
                f"the base of '{spec.articulation.name}' moves, and its contacts would be fitted too: hang the robot "
                "up and describe it with fixed_base=True"
            )
        self.spec, self.names, self.payload_link = spec, names, payload_link
        self.log = log.ordered(tuple(joint.name for joint in spec.articulation.movable_joints))
        _check_gaps(self.log)
        # A CSV file does not say the cycle: that of ORBIT's computers is 1 ms if not set otherwise.
        rate = log.description.rate if log.description is not None else 1000.0
        self.dt = dt or 1.0 / rate
        # A delay and a payload need no joint parameters per environment.
        self._backend, self._settings = backend, settings
        self._together = not set(names.quantities) or backend_of(backend).capabilities().has(
            Capability.RANDOMIZE_JOINTS
        )
        steps = math.ceil(self.log.duration / self.dt - 1e-6)
        grid = self.dt * np.arange(steps + 1, dtype=np.float64)
        # Rows of the log need not coincide with steps of physics.
        given = (self.log.target, self.log.target_velocity, self.log.target_effort)
        self._targets = torch.from_numpy(np.stack([resampled(grid, self.log.times, each) for each in given], 1)).float()
        # A row's targets act in the step that begins at its time, and its state is the one after that step.
        self._rows = np.clip(np.round(self.log.times / self.dt).astype(int), 0, steps)
        # Row of the log whose state the simulation starts from
        self._first = min(int(np.searchsorted(self.log.times, lead - 1e-9)), len(self.log.times) - 2) if lead else 0
        self._placed = {int(self._rows[row]): row for row in placements(self.log, RobotDescription.of(spec))}
        self._worlds: dict[int, World] = {}

    def run(self, values: FloatArray) -> FloatArray:
        """Return the simulated positions of candidates.

        Args:
            values: (N, P) parameters in the order of ``names.all``.

        Returns:
            (N, T, J) rad or m at the log's rows; NaN where a candidate's simulation failed.
        """
        if self._together:
            return self._follow(self._shared(len(values)), values)
        found: list[FloatArray] = []
        for row in values:
            # Built again, since these engines read joint parameters only when they load a robot.
            world = self._made(self.fitted(row).apply(self.spec), 1)
            try:
                found.append(self._follow(world, row[None], built=True))
            finally:
                world.close()
        return np.concatenate(found)

    def fitted(self, row: FloatArray) -> FittedRobot:
        """Return the parameters of a candidate (P,) by name, of a robot without name and source."""
        numbers = dict(zip(self.names.all, row.tolist(), strict=True))
        joints = {
            joint: {what: max(numbers[f"{what}:{joint}"], 0.0) for what in self.names.quantities}
            for joint in self.names.joints
        }
        return FittedRobot(
            robot="",
            source="",
            joints=joints if self.names.quantities else {},
            payload_link=self.payload_link,
            payload=numbers.get("payload", 0.0),
            gain=numbers.get("gain", 1.0),
            delay=numbers.get("delay", 0.0),
        )

    def present(self) -> FloatArray:
        """Return the parameters (P,) that the robot has."""
        joints = {joint.name: joint for joint in self.spec.articulation.joints}
        own = [getattr(joints[name], what) for what in self.names.quantities for name in self.names.joints]
        return np.array([*own, *(1.0 if name == "gain" else 0.0 for name in self.names.scalars)], np.float64)

    def close(self) -> None:
        """Close the worlds; idempotent."""
        while self._worlds:
            self._worlds.popitem()[1].close()

    def _made(self, spec: RobotSpec, count: int) -> World:
        scene = Scene(robots=(spec,), physics_dt=self.dt)
        return simulate(scene, count, self._backend, settings=self._settings)

    def _shared(self, count: int) -> World:
        # Built once for each number of candidates, as a search alternates between one and many: parameters of the ones
        # before are overwritten.
        if count not in self._worlds:
            self._worlds[count] = self._made(self.spec, count)
        return self._worlds[count]

    def _set(self, robot: Robot, values: FloatArray) -> None:
        names = self.names
        columns = [robot.joint_names.index(name) for name in names.joints]
        count = len(columns)
        blocks = {
            what: _tensor(np.maximum(values[:, place * count : (place + 1) * count], 0.0))
            for place, what in enumerate(names.quantities)
        }
        if blocks:
            robot.set_joint_parameters(**blocks, joints=columns)
        if (column := names.column("payload")) is not None:
            link = robot.link_names.index(self.payload_link)
            # From the nominal mass: the world still has the masses of the candidates before.
            own = robot.nominal_masses[:, [link]]
            robot.set_masses(own + _tensor(values[:, [column]]), links=[link])
        if (column := names.column("gain")) is not None:
            driven = list(robot.nominal_gains)
            own = torch.tensor([robot.nominal_gains[joint] for joint in driven])
            factor = _tensor(values[:, [column]])
            robot.set_gains(own[:, 0] * factor, own[:, 1] * factor, joints=driven)

    def _follow(self, world: World, values: FloatArray, built: bool = False) -> FloatArray:
        robot, count = next(iter(world.robots.values())), len(values)
        world.reset()
        if not built:
            self._set(robot, values)
        first = self._first
        self._place(robot, first, count)
        joints = range(len(self.log.joints))
        writers = [robot.target_writer(each, joints, checked=False) for each in JointTarget]
        column = self.names.column("delay")
        late = _tensor(values[:, column] / self.dt) if column is not None else torch.zeros(count)
        steps, begin = len(self._targets) - 1, int(self._rows[first])
        positions = torch.empty(steps + 1, count, len(self.log.joints))
        positions[begin] = robot.joint_positions
        try:
            # The first row's state is after its step, so that the world begins with the second.
            for step in range(begin + 1, steps + 1):
                for writer, targets in zip(writers, self._at(step - late).unbind(1), strict=True):
                    writer(targets)
                world.step(1)
                if (row := self._placed.get(step)) is not None:
                    # Put there by a client of a simulated robot, which no targets explain.
                    self._place(robot, row, count)
                positions[step] = robot.joint_positions
        except SimulationError:
            # Parameters that no engine can integrate are no fault of the search.
            positions[:] = torch.nan
        found = positions[self._rows].transpose(0, 1).double().numpy()
        found[:, :first] = self.log.position[:first]
        return found

    def _place(self, robot: Robot, row: int, count: int) -> None:
        """Put the robots where the log's was at a row."""
        there = [_tensor(each[[row]]).expand(count, -1) for each in (self.log.position, self.log.velocity)]
        robot.set_joint_state(there[0], there[1])

    def _at(self, place: Tensor) -> Tensor:
        """Return targets (N, 3, J) at fractional rows (N,), the first before the beginning."""
        # Before the first target arrived the robot held its place, which is what the first target says.
        place = place.clamp_min(0.0)
        low = place.long().clamp_max(len(self._targets) - 2)
        share = (place - low)[:, None, None]
        return torch.lerp(self._targets[low], self._targets[low + 1], share)


def payload_link_of(spec: RobotSpec) -> str:
    """Return the link of a robot that carries a payload: the end effector's, or the nearest above it with a mass."""
    articulation = spec.articulation
    masses = {link.name: link.mass for link in articulation.links}
    parents = {joint.child: joint.parent for joint in articulation.joints}
    name = spec.end_effectors[0].frame if spec.end_effectors else articulation.links[-1].name
    # A hand's frame has no mass: the link that carries it has.
    name = {frame.name: frame.link for frame in articulation.frames}.get(name, name)
    # A payload multiplies the link's inertia, which a link without a mass has not.
    while name in parents and masses.get(name, 0.0) <= 0.0:
        name = parents[name]
    return name


def fitted_joints(spec: RobotSpec, log: MotionLog, least: float = 0.02) -> tuple[str, ...]:
    """Return the joints that drive themselves and moved.

    Args:
        spec: robot.
        log: recorded motion.
        least: range of positions that counts as a motion, rad or m.

    Raises:
        ConfigurationError: none moved.
    """
    spans = dict(zip(log.joints, np.ptp(log.position, axis=0).tolist(), strict=True))
    own = [joint.name for joint in spec.articulation.movable_joints if joint.mimic is None]
    moved = tuple(name for name in own if spans.get(name, 0.0) > least)
    if not moved:
        raise ConfigurationError(
            f"no joint of '{spec.articulation.name}' moved by more than {least:g} rad or m in {log.source or 'the log'}"
        )
    return moved


def placements(log: MotionLog, description: RobotDescription) -> list[int]:
    """Return the rows at which a robot is elsewhere than it could have moved to since the row before.

    Args:
        log: recorded motion, with the description's joints in order.
        description: of the robot, whose limits of velocity count twice.
    """
    way = np.abs(np.diff(log.position, axis=0))
    most = 2.0 * np.array(description.velocity) * np.diff(log.times)[:, None] + 1e-3
    return (np.flatnonzero((way > most).any(1)) + 1).tolist()


def _check_gaps(log: MotionLog) -> None:
    """Check that a log has no gap, in which nobody knows the targets.

    Raises:
        ConfigurationError: names the first gap, and how to leave it out.
    """
    intervals = np.diff(log.times)
    # Slow recordings have long intervals everywhere.
    gaps = np.flatnonzero(intervals > max(_GAP, 10.0 * float(np.median(intervals))))
    if len(gaps):
        begin, end = log.times[gaps[0]], log.times[gaps[0] + 1]
        raise ConfigurationError(
            f"{log.source or 'the log'} has a gap from {begin:.3f} to {end:.3f} s of the part that is replayed: "
            "choose a part without it by --begin and --seconds"
        )


def predict(log: MotionLog, spec: RobotSpec, backend: str, delay: float = 0.0, dt: float | None = None) -> FloatArray:
    """Return positions (T, J) of a simulated robot that follows a log's targets, at the log's rows.

    Args:
        log: recorded motion.
        spec: robot, with a fixed base.
        backend: name of the physics backend.
        delay: seconds between a target and its effect.
        dt: seconds of a physics step; the robot's own cycle if None.
    """
    replay = LogReplay(log, spec, backend, ParameterNames((), (), ("delay",)), dt=dt, lead=delay)
    try:
        return replay.run(np.array([[delay]]))[0]
    finally:
        replay.close()


def rms(differences: FloatArray) -> float:
    """Return the root mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(differences))))


def resampled(grid: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate targets by monotone cubics (Fritsch and Butland 1984), which never leave the range of their ends.

    Lines between the rows of a smooth motion would miss accelerations: at 500 Hz they cost a fit of armature 10 times
    more than the rounding of the log. Steps stay steps.

    Args:
        grid: (S,) s, within the range of ``times``.
        times: (T,) s, rising.
        values: (T, J)

    Returns:
        (S, J)
    """
    length = np.diff(times)[:, None]
    slope = np.diff(values, axis=0) / length
    tangent = np.empty_like(values)
    tangent[0], tangent[-1] = slope[0], slope[-1]
    one, other = 2.0 * length[1:] + length[:-1], length[1:] + 2.0 * length[:-1]
    # The weighted harmonic mean of both slopes where they have the same sign, and 0 at turns.
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (one + other) / (one / slope[:-1] + other / slope[1:])
    tangent[1:-1] = np.where(slope[:-1] * slope[1:] > 0.0, mean, 0.0)
    row = np.clip(np.searchsorted(times, grid, side="right") - 1, 0, len(times) - 2)
    step = length[row]
    x = np.clip((grid - times[row])[:, None] / step, 0.0, 1.0)
    start, end = values[row], values[row + 1]
    bend = x * (1.0 - x) * step
    share = x * x * (3.0 - 2.0 * x)
    return start + (end - start) * share + bend * ((1.0 - x) * tangent[row] - x * tangent[row + 1])


def _tensor(values: FloatArray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))


def quantities_of(words: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split names of parameters into those of joints and those of the whole robot.

    Raises:
        ConfigurationError: a name is none.
    """
    scalars = ("delay", "payload", "gain")
    unknown = [word for word in words if word not in (*JOINT_QUANTITIES, *scalars)]
    if unknown or not words:
        raise ConfigurationError(
            f"what is fitted is of {', '.join((*JOINT_QUANTITIES, *scalars))}, not {', '.join(unknown) or 'nothing'}"
        )
    return tuple(each for each in JOINT_QUANTITIES if each in words), tuple(each for each in scalars if each in words)
