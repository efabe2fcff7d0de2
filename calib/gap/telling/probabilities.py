"""Calibrated probability of a named effect, from its probability among rivals and its gain.

The softmax over rivals knows only listed rivals. A small gain is often a second order of something large or unnamed.
The numbers were fitted to 446 names of cases that were no longer sealed: one to three effects, seeds 90001 to 90570,
without and with unknown errors. Each kind has the weight of a full run of the check (1000, 400, 400 and 200 cases), in
which 83 % are right.
"""

from __future__ import annotations

import math

_SHARPNESS = 0.7
"""Power of the probability among rivals: it differs too much between them. Source: the fit above, development seeds
90001-90570."""
_LEVEL, _SLOPE = 3.3, 1.2
"""Log-odds that a name of gain 200 is right, and their increase for each power of ten. Source: the fit above,
development seeds 90001-90570."""
_BESIDE_UNKNOWN = 2.1
"""By which they are less where something unknown is there too. Source: the fit above, development seeds 90001-90570."""
_MIDDLE, _LEAST, _MOST = 2.3, 1.3, 3.3
"""Powers of ten of the gain: the middle of those cases, and where they end. Source: the fit above, development seeds
90001-90570."""


def calibrated_probability(among_rivals: float, gain: float, *, beside_unknown: bool) -> float:
    """Chance that an effect is there.

    Parameters
    ----------
    among_rivals
        Its probability among its rivals.
    gain
        Twice the log-likelihood that it gains beside all others.
    beside_unknown
        Whether something unknown is reported as well.

    Examples
    --------
    >>> round(calibrated_probability(1.0, 2000.0, beside_unknown=False), 2)
    0.99
    >>> round(calibrated_probability(1.0, 50.0, beside_unknown=False), 2)
    0.93
    """
    power = min(max(math.log10(max(gain, 1.0)), _LEAST), _MOST)
    odds = _LEVEL + _SLOPE * (power - _MIDDLE) - (_BESIDE_UNKNOWN if beside_unknown else 0.0)
    return float(among_rivals**_SHARPNESS / (1.0 + math.exp(-odds)))
