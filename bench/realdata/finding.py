"""What is known of a recording beside what a method finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Finding:
    """One line of the table. `agrees` is None where nothing is known to compare with: a figure to know."""

    recording: str
    method: str
    quantity: str
    known: str
    ours: str
    verdict: str
    agrees: bool | None


def compared(
    recording: str,
    method: str,
    quantity: str,
    known: ArrayLike,
    ours: ArrayLike,
    sd: ArrayLike,
    *,
    within: ArrayLike,
    because: str,
) -> Finding:
    """A finding that agrees if every number is within `within`, plus two of our own sd, of the known one.

    Parameters
    ----------
    known, ours, sd, within : shape (k,), or one number for all
        In one unit. `because` says where `within` comes from.
    """
    k, o, s, w = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (known, ours, sd, within)))
    apart = np.abs(o - k)
    agrees = bool(np.isfinite(o).all() and (apart <= w + 2.0 * s).all())
    verdict = f"{'agrees' if agrees else 'differs'}: apart by {_numbers(apart, 2)}; {because}"
    return Finding(recording, method, quantity, _numbers(k, 6), with_sd(o, s), verdict, agrees)


def said(recording: str, method: str, quantity: str, known: str, ours: str, *, agrees: bool | None) -> Finding:
    """A finding in words: the method has to say the right thing."""
    verdict = {True: "as it should", False: "not as it should", None: "to know"}[agrees]
    return Finding(recording, method, quantity, known, ours, verdict, agrees)


def with_sd(values: ArrayLike, sd: ArrayLike) -> str:
    """``value ± sd`` with as many digits as the sd allows."""
    pairs = zip(*np.broadcast_arrays(np.atleast_1d(values), np.atleast_1d(sd)), strict=True)
    return ", ".join(_one(float(v), float(s)) for v, s in pairs)


def _one(value: float, sd: float) -> str:
    if not np.isfinite(value):
        return "none"
    if not (np.isfinite(sd) and sd > 0.0):
        return f"{value:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(sd))))
    if digits > 6:
        return f"{value:.6g} ± {sd:.1e}"
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def _numbers(values: Sequence[float] | np.ndarray, digits: int) -> str:
    shown = [f"{v:.{digits}g}" for v in values]
    return shown[0] if len(set(shown)) == 1 else ", ".join(shown)


def table(findings: Sequence[Finding]) -> str:
    """Markdown."""
    lines = ["| method | quantity | known answer | ours | verdict |", "|---|---|---|---|---|"]
    for f in findings:
        mark = {True: "", False: "**", None: ""}[f.agrees]
        lines.append(f"| `{f.method}` | {f.quantity} | {f.known} | {f.ours} | {mark}{f.verdict}{mark} |")
    return "\n".join(lines)
