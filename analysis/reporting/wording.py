"""Numbers in words, the same in a terminal and on a page."""

from __future__ import annotations

from typing import Final

from mapreplay.analysis.stats.estimates import Estimate

UNDEFINED = "-"


def counted(number: int, noun: str) -> str:
    """``1 log``, ``2 logs``: for a noun whose plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def interval(low: float, high: float, digits: int = 1, factor: float = 1) -> str:
    """``211.9 to 293.8``; of a share with `factor` 100, ``32.8 to 53.8``."""
    if low != low:
        return UNDEFINED
    return f"{factor * low:.{digits}f} to {factor * high:.{digits}f}"


def with_interval(estimate: Estimate, digits: int, factor: float = 1) -> str:
    """``238.5 (211.9 to 293.8)``; without an interval the mean alone."""
    mean = number(factor * estimate.mean, digits)
    if estimate.low != estimate.low:
        return mean
    return f"{mean} ({interval(estimate.low, estimate.high, digits, factor)})"


def number(value: float, digits: int = 0) -> str:
    """``238``."""
    return UNDEFINED if value != value else f"{value:.{digits}f}"


def share(value: float) -> str:
    """``47.1 %``; only 1 and 0 are written as all and nothing: ``>99.9 %``, ``<0.1 %``."""
    if value != value:
        return UNDEFINED
    if 0.9995 <= value < 1:
        return ">99.9 %"
    if 0 < abs(value) < 0.0005:
        return "<0.1 %" if value > 0 else ">-0.1 %"
    return f"{100 * value:.1f} %"


def percent(estimate: Estimate) -> str:
    """``47.1 % (32.8 to 53.8 %)``; without an interval the mean alone."""
    if estimate.mean != estimate.mean:
        return "an undefined share"
    mean = share(estimate.mean)
    if estimate.low != estimate.low:
        return mean
    return f"{mean} ({interval(estimate.low, estimate.high, factor=100)} %)"


def p_value(p: float) -> str:
    """``p = 0.031``, ``p < 0.001``."""
    return f"p {_compared(p)}"


def p_number(p: float) -> str:
    """``0.031``, ``< 0.001``: for a column with the heading p."""
    return _compared(p).removeprefix("= ")


SMALLEST_P: Final = 0.001
"""Smaller ones are not written out."""


def _compared(p: float) -> str:
    if p != p:
        return UNDEFINED
    if p < SMALLEST_P:
        return f"< {SMALLEST_P}"
    return "> 0.99" if 0.99 < p < 1 else f"= {p:.2g}"


MULTIPLE: Final = -1.0
"""A reduction of a time below this is written as a multiple of the other time."""


def reduction(estimate: Estimate) -> str:
    """A time compared with another, of the reduction ``1 - time / other``, which is at most 1.

    ``reduced by 47.1 % (32.8 to 53.8 %)``, ``7.4 % longer (2.0 to 11.3 %)``, ``64 times as long
    (31 to 97 times)``; where the signs differ, both ends are written in words. A time
    cannot be reduced by less than nothing, and a reduction by -6337 % is unreadable.
    """
    mean, low, high = estimate.mean, estimate.low, estimate.high
    if mean != mean:
        return "not comparable"
    said = f"reduced by {share(mean)}" if mean >= 0 else change(mean)
    if low != low:
        return said
    if low >= 0:
        return f"{said} ({interval(low, high, factor=100)} %)"
    if high < MULTIPLE:
        return f"{said} ({times(1 - high)} to {times(1 - low)})"
    if low >= MULTIPLE and high < 0:
        return f"{said} ({interval(high, low, factor=-100)} %)"
    return f"{said} ({change(low)} to {change(high)})"


def change(reduction: float) -> str:
    """``40.0 % less``, ``7.4 % longer`` or ``64 times as long``, of one reduction of a time."""
    if reduction != reduction:
        return UNDEFINED
    if reduction >= 0:
        return f"{share(reduction)} less"
    if reduction >= MULTIPLE:
        return f"{share(-reduction)} longer"
    return f"{times(1 - reduction)} as long"


def times(factor: float) -> str:
    """``64 times``, ``2.5 times``."""
    return f"{factor_digits(factor)} times"


def factor_digits(factor: float) -> str:
    """``64``, ``2.5``."""
    return f"{factor:.0f}" if factor >= 10 else f"{factor:.1f}"
