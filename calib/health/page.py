"""The health of a log as a page that stands alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from mavcal.calib import pages
from mavcal.calib.drawing.chart import Chart
from mavcal.calib.drawing.scale import limits_of
from mavcal.calib.flight.series import Series, series_of
from mavcal.calib.health.finding import NAMES, HealthVerdict
from mavcal.calib.health.report import HealthReport
from mavcal.calib.recording import Recording

_COLOURS = ("#c4483d", "#2f9455", "#3d7cc9")
"""Of x, y and z, on white and on black."""
_WORDS = {HealthVerdict.CANNOT_SAY: "cannot say"}


def health_page(report: HealthReport, recording: Recording, *, title: str) -> str:
    """HTML with every verdict, its evidence and the sensors over time; no script, nothing from elsewhere."""
    return pages.page(
        "mavcal.calib.health",
        "health.html",
        title=title,
        report=report,
        worded={verdict: _WORDS.get(verdict, verdict.value) for verdict in HealthVerdict},
        pictures=_pictures(series_of(recording)),
    )


def _pictures(series: Sequence[Series]) -> list[Markup]:
    return [_picture(one) for one in series if len(one.t) > 1 and np.isfinite(one.values).any()]


def _picture(one: Series) -> Markup:
    name = f"{NAMES.get(one.sensor, one.sensor.value.replace('_', ' '))} {one.instance + 1}"
    chart = Chart(name, "s", one.unit, (float(one.t[0]), float(one.t[-1])), limits_of(one.values))
    for axis, values in enumerate(one.values):
        chart.line(one.t, values, _COLOURS[axis], "xyz"[axis] if len(one.values) > 1 else "", thin=True)
    return chart.drawn()
