"""A reference that is too poor to judge a sensor by: what is said of it, and what would make it better.

Its trajectory bends to any reading, so that effects which are measured along it are made by it. Only the differences of
instances are left, which need no attitude.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from mavcal.calib.gap.problem import ReferenceInfo
from mavcal.calib.gap.reference.checks import Refusal
from mavcal.calib.gap.schema import REFERENCE_NEED, USELESS_DEG
from mavcal.calib.recording import Sensor


def refusals(info: ReferenceInfo, sensors: Iterable[Sensor]) -> tuple[Refusal, ...]:
    """Why the `sensors` of a recording are not judged by its reference `info`, one line each."""
    reason = f"{uselessness(info)}: no single {{}} is compared with it"
    return tuple((s.value, reason.format(s.value), REFERENCE_NEED) for s in dict.fromkeys(sensors))


def uselessness(info: ReferenceInfo) -> str:
    """How badly the attitude of a useless reference is known, and the limit."""
    if math.isinf(info.att_sigma_deg):
        return "the trajectory that was estimated contradicts its own inertial unit all the time"
    return (
        f"the attitude of the reference is known to {info.att_sigma_deg:.1f} deg only, {USELESS_DEG:g} deg are needed"
    )


def not_learned(info: ReferenceInfo) -> str:
    """The same of another recording, from which noise was to be learned."""
    return (
        f"nothing was learned of single sensors from the simulator's or a nominal recording: {uselessness(info)}; "
        f"it takes {REFERENCE_NEED}"
    )
