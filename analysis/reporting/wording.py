"""Numbers in words, the same in a terminal and on a page."""

from __future__ import annotations

from mapreplay.analysis.stats.estimates import Estimate

UNDEFINED = "-"


def counted(number: int, noun: str) -> str:
    """``1 log``, ``2 logs``: of a noun whose plural takes an s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def with_interval(estimate: Estimate, digits: int) -> str:
    """``238.5 (211.9 to 293.8)``; without an interval the mean alone."""
    if estimate.mean != estimate.mean:
        return UNDEFINED
    mean = f"{estimate.mean:.{digits}f}"
    if estimate.low != estimate.low:
        return mean
    return f"{mean} ({estimate.low:.{digits}f} to {estimate.high:.{digits}f})"


def share(value: float) -> str:
    """``47.1 %``."""
    return UNDEFINED if value != value else f"{100 * value:.1f} %"


def percent(estimate: Estimate) -> str:
    """``47.1 % (32.8 to 53.8 %)``; without an interval the mean alone."""
    if estimate.mean != estimate.mean:
        return "an undefined share"
    mean = share(estimate.mean)
    if estimate.low != estimate.low:
        return mean
    return f"{mean} ({100 * estimate.low:.1f} to {100 * estimate.high:.1f} %)"


def p_value(p: float) -> str:
    """Two digits, and no more zeros than one can read."""
    if p != p:
        return UNDEFINED
    return f"{p:.2g}" if p >= 0.0001 else "<0.0001"
