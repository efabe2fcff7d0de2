"""Numbers with their 95 % intervals in words: ratios and differences, with as many digits as are known."""

from __future__ import annotations

import math

from mavcal.calib.gap.schema import ParameterEstimate

_FINEST = 4
"""Most decimals of a number in a sentence. Chosen, not measured: finer than any of these effects is known."""
_ROUND = 1e-3
"""Tolerance, in powers of ten, with which a half interval just below a power of ten counts as that power, against
rounding errors."""


def ratio_of(p: ParameterEstimate) -> tuple[float, float, float]:
    """Real over simulated with its 95 % interval, for a relative parameter."""
    if p.ratio is None:
        return 1.0 + p.value, 1.0 + p.ci95[0], 1.0 + p.ci95[1]
    low, high = p.ratio_ci95 or (math.nan, math.nan)
    return p.ratio, low, high


def after_number(unit: str) -> str:
    """The unit as it follows a number; empty where it has none."""
    return "" if unit in {"", "1"} else f" {unit}"


def _decimals(low: float, high: float, least: int = 0) -> int:
    """Number of decimals up to the first digit of half the interval."""
    half = 0.5 * abs(high - low)
    return min(max(-math.floor(math.log10(half) + _ROUND), least), _FINEST) if 0.0 < half < math.inf else max(2, least)


def rounded(value: float, low: float, high: float, *, least: int = 0) -> str:
    """A number with the decimals that its interval justifies, at least `least` of them."""
    return f"{value:.{_decimals(low, high, least)}f}"


def range_of(low: float, high: float, *, least: int = 0) -> str:
    """``1.54 to 1.66``; empty for a value without an interval."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not determined by itself"
    decimals = _decimals(low, high, least)
    return f"{low:.{decimals}f} to {high:.{decimals}f}" if high > low else ""


def bracketed(low: float, high: float, *, least: int = 0) -> str:
    """The interval in brackets, to follow a number."""
    said = range_of(low, high, least=least)
    return f" ({said})" if said else ""


def times(p: ParameterEstimate, what: str) -> str:
    """``1.60 times the rotor drag (1.54 to 1.66)``."""
    value, low, high = ratio_of(p)
    return f"{rounded(value, low, high, least=2)} times {what}{bracketed(low, high, least=2)}"


def more_or_less(p: ParameterEstimate, scale: float, unit: str, more: str, less: str) -> str:
    """``40 ms later (35 to 45)``: the size of an absolute difference, and the word for its sign."""
    sign = math.copysign(scale, p.value)
    low, high = sorted(sign * edge for edge in p.ci95)
    amount = rounded(sign * p.value, low, high)
    return f"{amount}{after_number(unit)} {more if p.value >= 0.0 else less}{bracketed(low, high)}"
