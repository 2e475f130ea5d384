"""Estimates over floor plans, with intervals: means, paired effects, times, shares.

The unit is the floor plan (with its start). Runs of one floor plan with several seeds are
averaged first (`average_runs`): the spread of those averages already holds both sources of
chance, so that resampling floor plans alone gives intervals that cover; resampling seeds once
more within them would count that chance twice (Davison and Hinkley 1997, section 3.8).

Values are compared in pairs, floor plan by floor plan. What is undefined is NaN, never 0: it is
left out of a mean, and counted. Intervals are BCa bootstrap (Efron 1987) at 95 %, seeded, so
that the same values give the same interval. Tests of significance are in `significance`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from scipy import stats

RESAMPLES: Final = 9_999
CONFIDENCE: Final = 0.95

Values: TypeAlias = Sequence[float] | npt.NDArray[np.floating]
"""One value per floor plan; NaN where it is undefined."""

NEVER: Final = math.inf
"""The time of what never happened: the agent was sealed in, or ran out of steps."""

_Plan = TypeVar("_Plan", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """A mean (or another statistic) over floor plans and its 95 % interval."""

    mean: float
    low: float
    high: float
    plans: int
    """Floor plans that were averaged."""
    undefined: int = 0
    """Floor plans that were left out, because their value is undefined."""


def mean_interval(values: Values, resamples: int = RESAMPLES) -> Estimate:
    """Mean of values, one for each floor plan, with a BCa bootstrap interval.

    The interval is the mean itself where all values are equal (also where all differences are
    0), and NaN for fewer than two. NaN values are left out and counted.
    """
    given = np.asarray(values, np.float64)
    data = given[~np.isnan(given)]
    undefined = int(given.size - data.size)
    if data.size == 0:
        return Estimate(math.nan, math.nan, math.nan, 0, undefined)
    mean, plans = float(data.mean()), int(data.size)
    if plans < 2:
        return Estimate(mean, math.nan, math.nan, plans, undefined)
    if np.ptp(data) <= 1e-12 * np.abs(data).max():  # equal, but for rounding
        return Estimate(mean, mean, mean, plans, undefined)
    interval = stats.bootstrap(
        (data,),
        np.mean,
        n_resamples=resamples,
        confidence_level=CONFIDENCE,
        method="BCa",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Estimate(mean, float(interval.low), float(interval.high), plans, undefined)


def pooled_interval(
    statistic: Callable[[npt.NDArray[np.intp]], float], plans: int, resamples: int = 1_999
) -> Estimate:
    """Any statistic of a set of floor plans, such as one pooled over their cells.

    `statistic` gets numbers of floor plans (intp[n] in 0..plans-1, with repetitions) and
    returns a number. The interval is NaN for fewer than two plans or an undefined statistic.
    """
    everyone = np.arange(plans)
    value = float(statistic(everyone)) if plans else math.nan
    if plans < 2 or math.isnan(value):
        return Estimate(value, math.nan, math.nan, plans)
    without = [float(statistic(np.delete(everyone, i))) for i in everyone]
    if np.ptp(without) <= 1e-12 * max(abs(value), 1e-300):  # all plans agree
        return Estimate(value, value, value, plans)
    interval = stats.bootstrap(
        (everyone,),
        lambda sample: statistic(np.asarray(sample, np.intp)),
        n_resamples=resamples,
        confidence_level=CONFIDENCE,
        method="BCa",
        vectorized=False,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high), plans)


def average_runs(runs: Iterable[tuple[_Plan, float]]) -> dict[_Plan, float]:
    """(floor plan, value) of every run -> the mean of each floor plan, in order of appearance.

    The mean of a floor plan is NaN if one of its runs is undefined.
    """
    collected: dict[_Plan, list[float]] = {}
    for plan, value in runs:
        collected.setdefault(plan, []).append(value)
    return {plan: float(np.mean(values)) for plan, values in collected.items()}


def align(
    candidate: Mapping[_Plan, float], reference: Mapping[_Plan, float]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Both values (float64[n]) of the floor plans that have both, in the order of `reference`."""
    plans = [plan for plan in reference if plan in candidate]
    return (
        np.array([candidate[plan] for plan in plans], np.float64),
        np.array([reference[plan] for plan in plans], np.float64),
    )


def differences(candidate: Values, reference: Values) -> npt.NDArray[np.float64]:
    """float64[n]: candidate - reference, floor plan by floor plan; NaN where undefined.

    Raises:
        ValueError: they are not of the same floor plans (other lengths).
    """
    a, b = _paired(candidate, reference)
    with np.errstate(invalid="ignore"):  # never - never is undefined
        return a - b


def paired_difference(candidate: Values, reference: Values) -> Estimate:
    """Mean over floor plans of candidate - reference, with its paired interval."""
    return mean_interval(differences(candidate, reference))


def reductions(candidate: Values, reference: Values) -> npt.NDArray[np.float64]:
    """float64[n]: 1 - candidate / reference of times; NaN where the reference took no time.

    Raises:
        ValueError: other lengths, or a negative time.
    """
    a, b = _paired(candidate, reference)
    if (a < 0).any() or (b < 0).any():
        raise ValueError("a time is negative")
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(b > 0, 1 - a / b, np.nan)


def paired_reduction(candidate: Values, reference: Values) -> Estimate:
    """Mean over floor plans of 1 - candidate / reference (the paper's relative reduction of
    mapping time), with its paired interval.
    """
    return mean_interval(reductions(candidate, reference))


def restricted(times: Values, budget: float | Values) -> npt.NDArray[np.float64]:
    """float64[n]: min(time, budget), where `NEVER` takes the whole budget.

    `budget` is common to all that is compared: one number, or one for each floor plan. NaN
    (a run that was cut off before it ended or used up the budget) stays undefined.

    Raises:
        ValueError: other lengths, or a budget that is not a positive number.
    """
    limit = np.broadcast_to(np.asarray(budget, np.float64), np.shape(times))
    if not (np.isfinite(limit).all() and (limit > 0).all()):
        raise ValueError("a budget must be a positive number")
    return np.minimum(np.asarray(times, np.float64), limit)


def restricted_mean(times: Values, budget: float | Values) -> Estimate:
    """Restricted mean time: the mean of min(time, budget), with its interval.

    A failure is a competing event, not censoring: an agent that is sealed in never reaches the
    target, so it counts with the whole budget.
    """
    return mean_interval(restricted(times, budget))


def restricted_mean_difference(
    candidate: Values, reference: Values, budget: float | Values
) -> Estimate:
    """Difference of the restricted means under one budget, with its paired interval."""
    return paired_difference(restricted(candidate, budget), restricted(reference, budget))


@dataclass(frozen=True)
class Proportion:
    """A share of floor plans, episodes or sealings, and its 95 % Wilson interval."""

    count: int
    of: int
    share: float
    low: float
    high: float


def proportion(count: int, of: int) -> Proportion:
    """`count` of `of`, with the Wilson score interval; NaN of none.

    Raises:
        ValueError: not 0 <= count <= of.
    """
    if not 0 <= count <= of:
        raise ValueError(f"{count} of {of} is not a share")
    if of == 0:
        return Proportion(0, 0, math.nan, math.nan, math.nan)
    interval = stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return Proportion(count, of, count / of, float(interval.low), float(interval.high))


def cumulative_incidence(times: Values, at: Values) -> list[Proportion]:
    """The share of floor plans where it has happened by each of the moments `at`.

    `times` has one per floor plan, `NEVER` where a competing event (sealed in, out of steps)
    came first. With every episode followed to its end this is the Aalen-Johansen estimate;
    Kaplan-Meier would treat failures as censored, and be too optimistic.

    Raises:
        ValueError: a time is undefined: leave out episodes that were cut off.
    """
    reached = np.asarray(times, np.float64)
    if np.isnan(reached).any():
        raise ValueError("a time is undefined: leave out episodes that were cut off")
    return [proportion(int((reached <= moment).sum()), reached.size) for moment in at]


def _paired(
    candidate: Values, reference: Values
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    a, b = np.asarray(candidate, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape:
        raise ValueError(f"{a.size} and {b.size} values are not pairs")
    return a, b
