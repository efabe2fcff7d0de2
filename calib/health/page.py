"""Health of a log as a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from mavcal.calib import pages
from mavcal.calib.drawing.chart import Chart
from mavcal.calib.drawing.scale import limits_of
from mavcal.calib.flight.series import SHOWN, Series, series_of
from mavcal.calib.health.finding import NAMES, HealthVerdict
from mavcal.calib.health.report import HealthReport
from mavcal.calib.recording import Recording

_COLOURS = ("#c4483d", "#2f9455", "#3d7cc9")
"""Colours of x, y and z, on white and on black."""
_WORDS = {HealthVerdict.CANNOT_SAY: "cannot say"}


def health_page(report: HealthReport, recording: Recording, *, title: str) -> str:
    """HTML with every verdict, its evidence and the sensors over time; no script, nothing from elsewhere."""
    return pages.page(
        "mavcal.calib.health",
        "health.html",
        title=title,
        report=report,
        typeset=_typeset,
        worded={verdict: _WORDS.get(verdict, verdict.value) for verdict in HealthVerdict},
        pictures=_pictures(series_of(recording), _begin(recording)),
    )


def _typeset(text: str) -> str:
    """`text` with typographic characters that a terminal may lack."""
    return text.replace("+-", "\u00b1").replace("m/s2", "m/s\u00b2").replace("uT", "\u00b5T")


def _begin(recording: Recording) -> float:
    """Vehicle time at the start of the series; findings state their times on that clock."""
    return min((float(c.t[0]) for c in recording.channels if c.sensor in SHOWN and len(c)), default=0.0)


def _pictures(series: Sequence[Series], begin: float) -> list[Markup]:
    return [_picture(one, begin) for one in series if len(one.t) > 1 and np.isfinite(one.values).any()]


def _picture(one: Series, begin: float) -> Markup:
    name = f"{NAMES.get(one.sensor, one.sensor.value.replace('_', ' '))} {one.instance + 1}"
    t = one.t + begin
    chart = Chart(name, "s", _typeset(one.unit), (float(t[0]), float(t[-1])), limits_of(one.values))
    for axis, values in enumerate(one.values):
        chart.line(t, values, _COLOURS[axis], "xyz"[axis] if len(one.values) > 1 else "", thin=True)
    return chart.drawn()
