"""Estimates from samples: values with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

CONFIDENCE = 0.95
_RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """A value, and the interval that holds the true one with a confidence of 95 %."""

    value: float
    """Estimate from the sample."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""

    def percent(self) -> str:
        """Return the value and its interval in percent, for people."""
        return f"{100.0 * self.value:.1f} % [{100.0 * self.low:.1f}, {100.0 * self.high:.1f}]"


def proportion(successes: int, trials: int) -> Estimate:
    """Return share of successes among independent trials, with Wilson's score interval.

    E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927), 209-212.
    """
    # Wilson's interval stays within [0, 1] and holds for few trials, unlike the normal approximation.
    z = NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE)
    rate, z2 = successes / trials, z * z / trials
    center = (rate + 0.5 * z2) / (1.0 + z2)
    half = z * ((rate * (1.0 - rate) + 0.25 * z2) / trials) ** 0.5 / (1.0 + z2)
    return Estimate(rate, max(0.0, center - half), min(1.0, center + half))


def mean(values: Sequence[float]) -> Estimate:
    """Return the mean of independent values of any distribution, with the bootstrap's percentile interval.

    Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.
    """
    sample = np.asarray(values, np.float64)
    # A fixed seed: equal samples give equal intervals.
    rows = np.random.default_rng(0).integers(len(sample), size=(_RESAMPLES, len(sample)))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(sample[rows].mean(axis=1), (tail, 1.0 - tail))
    return Estimate(float(sample.mean()), float(low), float(high))


@dataclass(frozen=True)
class Statistic:
    """Mean and standard deviation of a sample (population formula, not Bessel-corrected)."""

    mean: float
    """Mean of the sample."""
    deviation: float
    """Standard deviation of the sample."""


def statistic(values: Sequence[float]) -> Statistic:
    """Return mean and standard deviation of the values."""
    mean = sum(values) / len(values)
    return Statistic(mean, (sum((value - mean) ** 2 for value in values) / len(values)) ** 0.5)
