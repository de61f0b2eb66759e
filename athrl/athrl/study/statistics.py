"""Means over seeds with their 95 % intervals, by a stratified bootstrap."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from athrl.errors import needs

CONFIDENCE = 0.95
RESAMPLES = 10_000


@dataclass(frozen=True)
class Estimate:
    """A mean over seeds; `low` and `high` are the ends of its interval, none with a single seed."""

    mean: float
    low: float | None
    high: float | None
    values: tuple[float, ...]

    def as_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        return asdict(self) | {"values": list(self.values)}


def estimate(strata: Sequence[Sequence[float]]) -> Estimate:
    """Return the mean of the means of some strata, such as the seeds in each town, and its interval.

    The seeds are drawn again within each stratum, 10,000 times, and the interval holds the middle 95 % of the
    means: the stratified percentile bootstrap of Agarwal et al., "Deep reinforcement learning at the edge of
    the statistical precipice", 2021. With a few seeds it is too narrow; with one each there is none.

    Args:
        strata: values of the seeds, one value or more in each.
    """
    means = [statistics.fmean(stratum) for stratum in strata]
    values = tuple(value for stratum in strata for value in stratum)
    mean = statistics.fmean(means)
    if all(len(stratum) < 2 for stratum in strata):
        return Estimate(_rounded(mean), None, None, values)
    if all(len(set(stratum)) < 2 for stratum in strata):  # of which scipy says "not a number"
        return Estimate(_rounded(mean), _rounded(mean), _rounded(mean), values)
    low, high = _bootstrapped(strata)
    return Estimate(_rounded(mean), _rounded(low), _rounded(high), values)


def _bootstrapped(strata: Sequence[Sequence[float]]) -> tuple[float, float]:
    with needs("study"):
        import numpy as np
        from scipy.stats import bootstrap
    # scipy wants two values of each sample: a single one, twice, is drawn again as itself.
    samples = tuple(list(stratum) * (2 if len(stratum) == 1 else 1) for stratum in strata)
    found = bootstrap(
        samples,
        lambda *drawn, axis: np.mean([np.mean(sample, axis=axis) for sample in drawn], axis=0),
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=True,
        rng=0,
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
