"""Parameters of a robot's mechanism fitted to a log of its motion, with their uncertainty.

Least squares refine the robot as it is, or the best candidate of a search by CMA-ES over the whole range, whose
generation is simulated in as many worlds at once. Derivatives are differences between worlds. The curvature at the
result gives the uncertainty; parameters that the log does not determine keep the values of the robot's description.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from orbit_assets.fitted import FittedRobot
from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_deploy.log_replay import LogReplay, rms

LONGEST_DELAY = 0.05
"""Longest delay of a candidate, s."""
# Range of each scalar
_RANGES = {"delay": (0.0, LONGEST_DELAY), "payload": (0.0, 5.0), "gain": (0.5, 2.0)}
# A joint's friction, damping and armature at the end of their ranges take this share of its effort limit: at any speed,
# at full speed, and at full acceleration
_SHARE = 0.2
# Effort limit of joints without one, N m or N
_EFFORT = 20.0
# Difference between two worlds for a derivative, as a share of the range: smaller ones drown in single precision, as
# all joints' delay, damping and armature together change positions by 1e-5 rad only
_DIFFERENCE = 1e-2
# Distance from the ends of the range at which the refinement begins
_INSIDE = 0.02
# A parameter is determined if its deviation is at most this share of its range, or its value this many deviations away
# from the description's
_SURE, _AWAY = 0.02, 2.0
# Share of the squared error, and of the range, that a step of refinement must change
_GAIN, _STEP = 1e-3, 1e-7


@dataclass(frozen=True, kw_only=True)
class IdentificationSettings:
    """Settings of a search."""

    worlds: int = 24
    """Candidates of a generation, each in a world of its own."""
    generations: int = 0
    """Generations of CMA-ES, for robots that are far from their description."""
    refinements: int = 30
    """Most evaluations of the refinement."""
    seed: int = 0
    """Seed of CMA-ES."""

    def __post_init__(self) -> None:
        for name, least in (("worlds", 4), ("generations", 0), ("refinements", 1)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name} of an identification must be {least} or more")


@dataclass(frozen=True)
class Identification:
    """Result of a search."""

    names: tuple[str, ...]
    """Names of the parameters, such as ``friction:joint1`` and ``delay``."""
    values: FloatArray
    """(P,) of the description where the log does not determine them."""
    deviations: FloatArray
    """(P,) standard deviations; infinite for what the log does not determine."""
    before: float
    """Root mean square of simulated minus recorded positions of the robot as it was, rad or m."""
    after: float
    """The same with the fitted parameters."""
    fitted: FittedRobot
    """Parameters by name, with their source."""


def identify(
    replay: LogReplay,
    robot: str,
    backend: str,
    settings: IdentificationSettings | None = None,
    report: Callable[[str], object] = lambda text: None,
    slopes: LogReplay | None = None,
) -> Identification:
    """Fit a robot's parameters to a log.

    Args:
        replay: of the log, with the parameters that are fitted.
        robot: name in the catalogue, for the result.
        backend: name of the engine, for the result.
        settings: of the search.
        report: called with a line about each stage.
        slopes: replay of the same log and parameters on another engine, which computes the derivatives; for engines
            that simulate candidates one after another.

    Raises:
        ConfigurationError: no candidate can be simulated.
    """
    settings = settings or IdentificationSettings()
    search = _Search(replay, slopes or replay)
    start = search.scaled(replay.present())
    before = search.errors(start[None])[0]
    report(f"as it is: {before:.3g} rms")
    best = search.explore(start, settings, report)
    free = np.ones(len(start), bool)
    best, error, jacobian = search.refine(best, free, settings.refinements, report)
    deviations = search.deviations(best, jacobian)
    free = search.determined(best, start, deviations)
    if free.any() and not free.all():
        # The others were fitted together with numbers that nobody knows.
        best = np.where(free, best, start)
        best, error, _ = search.refine(best, free, settings.refinements, report)
    best, deviations = np.where(free, best, start), np.where(free, deviations, np.inf)
    values = np.where(free, search.values(best), replay.present())
    fitted = replace(
        _without(
            replay.fitted(values), [name for name, known in zip(replay.names.all, free, strict=True) if not known]
        ),
        robot=robot,
        source=replay.log.source,
        backend=backend,
        deviations=dict(zip(replay.names.all, deviations.tolist(), strict=True)),
        rms_before=before,
        rms=error,
    )
    return Identification(replay.names.all, values, deviations, before, error, fitted)


def _without(fitted: FittedRobot, names: Sequence[str]) -> FittedRobot:
    """Return a fitted robot without some quantities of joints, which are the catalogue's again."""
    joints = {
        joint: {what: value for what, value in each.items() if f"{what}:{joint}" not in names}
        for joint, each in fitted.joints.items()
    }
    return replace(fitted, joints={joint: each for joint, each in joints.items() if each})


class _Search:
    """Search in scaled parameters, each in [0, 1]."""

    def __init__(self, replay: LogReplay, slopes: LogReplay) -> None:
        self._replay, self._slopes, self._log = replay, slopes, replay.log
        self._lower, self._upper = _ranges(replay)
        # Only joints that are fitted count, others follow their targets in any case.
        counted = replay.names.joints or self._log.joints
        self._columns = [self._log.joints.index(name) for name in counted]

    def scaled(self, values: FloatArray) -> FloatArray:
        """Return (P,) in [0, 1]."""
        return np.clip((values - self._lower) / (self._upper - self._lower), 0.0, 1.0)

    def values(self, scaled: FloatArray) -> FloatArray:
        """Return parameters (..., P)."""
        return self._lower + (self._upper - self._lower) * scaled

    def residuals(self, scaled: FloatArray) -> FloatArray:
        """Return simulated minus recorded positions (N, M); large where a simulation failed."""
        return self._away(self._replay, scaled)

    def _away(self, replay: LogReplay, scaled: FloatArray) -> FloatArray:
        away = replay.run(self.values(scaled)) - self._log.position
        # Ten radians: worse than any motion, and still a number that the searches can rank.
        return np.nan_to_num(away[:, :, self._columns], nan=10.0).reshape(len(scaled), -1)

    def errors(self, scaled: FloatArray) -> FloatArray:
        """Return root mean squares (N,)."""
        return np.sqrt(np.mean(np.square(self.residuals(scaled)), 1))

    def explore(
        self, start: FloatArray, settings: IdentificationSettings, report: Callable[[str], object]
    ) -> FloatArray:
        """Return the best candidate of CMA-ES (P,)."""
        if not settings.generations:
            return start
        try:
            from cmaes import CMA  # pyright: ignore[reportMissingImports] - an extra
        except ImportError:
            raise ConfigurationError(
                f"identification needs cmaes: {install_command('orbit-deploy[identify]')}"
            ) from None
        # Zero is the likeliest value of many parameters, but a mean at the end of the range samples one side only.
        optimizer = CMA(
            np.clip(start, 0.1, 0.9),
            0.2,
            np.tile([0.0, 1.0], (len(start), 1)),
            seed=settings.seed,
            population_size=settings.worlds,
        )
        # The robot as it is stays the best if no candidate beats it.
        best, error = start, float(self.errors(start[None])[0])
        for generation in range(settings.generations):
            candidates = np.stack([optimizer.ask() for _ in range(settings.worlds)])
            errors = self.errors(candidates)
            # A failed simulation has 10 in all rows.
            if generation == 0 and not (errors < 5.0).any():
                raise ConfigurationError("no candidate of the first generation can be simulated: is this its log?")
            # All candidates of a generation were simulated at once; the optimiser learns of them together.
            optimizer.tell([(each, float(value)) for each, value in zip(candidates, errors, strict=True)])
            if errors.min() < error:
                best, error = candidates[int(errors.argmin())], float(errors.min())
            if generation % 5 == 4:
                report(f"generation {generation + 1}: {error:.3g} rms")
            if optimizer.should_stop():
                break
        return best

    def refine(
        self, best: FloatArray, free: npt.NDArray[np.bool_], steps: int, report: Callable[[str], object]
    ) -> tuple[FloatArray, float, FloatArray]:
        """Refine a candidate.

        Args:
            best: (P,) candidate.
            free: (P,) parameters that are refined.
            steps: most evaluations.
            report: called with a line about each evaluation.

        Returns:
            The refined candidate (P,), its error and the derivatives (M, F) of its residuals by the free parameters.
        """
        tried = 0

        def at(scaled: FloatArray) -> FloatArray:
            whole = best.copy()
            whole[free] = scaled
            return whole

        def residual(scaled: FloatArray) -> FloatArray:
            nonlocal tried
            tried, found = tried + 1, self.residuals(at(scaled)[None])[0]
            report(f"refinement {tried}: {rms(found):.3g} rms")
            return found

        def derivatives(scaled: FloatArray) -> FloatArray:
            return self._derivatives(at(scaled), free)

        # From the end of a range the steps would be as small as the way to it.
        start = np.clip(best[free], _INSIDE, 1.0 - _INSIDE)
        slope = derivatives(start)
        if not slope.any():
            return at(start), rms(residual(start)), slope
        found = least_squares(
            residual,
            start,
            derivatives,  # pyright: ignore[reportArgumentType] - SciPy's stubs name words only
            bounds=(0.0, 1.0),
            # By their effect: parameters differ in it by orders of magnitude.
            x_scale="jac",
            # Single precision ends the descent long before double precision would.
            ftol=_GAIN,
            xtol=_STEP,
            gtol=None,  # pyright: ignore[reportArgumentType] - switched off
            max_nfev=steps,
        )
        return at(found.x), rms(found.fun), found.jac

    def _derivatives(self, at: FloatArray, free: npt.NDArray[np.bool_]) -> FloatArray:
        """Return derivatives (M, F) of the residuals by central differences, all worlds at once."""
        shifts = _DIFFERENCE * np.eye(len(at))[free]
        above, below = np.clip(at + shifts, 0.0, 1.0), np.clip(at - shifts, 0.0, 1.0)
        # One run of 2 F worlds, as a world costs less than a run.
        found = self._away(self._slopes, np.concatenate((above, below)))
        # Shorter at an end of the range, where a shift is cut off.
        return ((found[: len(above)] - found[len(above) :]) / (above - below).sum(1)[:, None]).T

    def determined(self, best: FloatArray, start: FloatArray, deviations: FloatArray) -> npt.NDArray[np.bool_]:
        """Return (P,) True for parameters that are known well, or known to be others than the robot's description says.

        Args:
            best: (P,) fitted candidate.
            start: (P,) candidate of the description.
            deviations: (P,) standard deviations.
        """
        away = np.abs(best - start) * (self._upper - self._lower)
        return (deviations <= _SURE * (self._upper - self._lower)) | (away > _AWAY * deviations)

    def deviations(self, best: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Return standard deviations (P,) of the parameters, from the residuals that are left.

        Residuals of neighbouring rows are alike, so that fewer of them are independent: their number is divided by the
        time over which they are correlated.
        """
        residual = self.residuals(best[None])[0]
        rows = residual.reshape(len(self._log.times), -1)
        independent = max(residual.size / _correlation(rows), len(best) + 1.0)
        # The fit has used up one independent residual for each parameter.
        variance = float(residual @ residual) / residual.size * independent / (independent - len(best))
        slope = self._upper - self._lower
        normal = (jacobian / slope).T @ (jacobian / slope) * independent / residual.size
        weights, vectors = np.linalg.eigh(normal)
        # Directions that change nothing are not determined.
        known = weights > 1e-12 * weights.max(initial=1e-30)
        inverse = np.where(known, 1.0 / np.where(known, weights, 1.0), np.inf)
        with np.errstate(invalid="ignore"):
            spread = np.where(vectors**2 > 1e-12, vectors**2 * inverse, 0.0).sum(1)
            # No residual is left where a still log fits anything, and then nothing is known.
            return np.where(np.isinf(spread), np.inf, np.sqrt(variance * spread))


def _correlation(rows: FloatArray) -> float:
    """Return the mean number of neighbouring rows (T, J) that are alike, 1 for independent ones."""
    centred = rows - rows.mean(0)
    # Padded with zeros: a transform joins the end of the rows to their beginning.
    power = np.abs(np.fft.rfft(centred, 2 * len(rows), axis=0)) ** 2
    lags = np.fft.irfft(power, axis=0)[: len(rows)]
    # Joints whose difference is constant have no power, and no correlation.
    shares = lags / np.maximum(lags[0], 1e-300)
    times: list[float] = []
    for column in shares.T:
        # Up to the first negative one, beyond which there is noise only
        end = int(np.argmax(column <= 0.0)) or len(column)
        times.append(1.0 + 2.0 * float(column[1:end].sum()))
    return float(np.mean(times))


def _ranges(replay: LogReplay) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper ends (P,) of the parameters' ranges."""
    described = RobotDescription.of(replay.spec)
    ends: dict[str, float] = {}
    for place, name in enumerate(described.joints):
        effort = described.effort[place] if np.isfinite(described.effort[place]) else _EFFORT
        ends[f"friction:{name}"] = _SHARE * effort
        ends[f"damping:{name}"] = _SHARE * effort / described.velocity[place]
        ends[f"armature:{name}"] = _SHARE * effort / described.acceleration[place]
    lower, upper = zip(*(_RANGES.get(name, (0.0, ends.get(name, 0.0))) for name in replay.names.all), strict=True)
    # A robot as it is must be within the range.
    return np.array(lower), np.maximum(np.array(upper), 4.0 * replay.present())
