"""Picture of each sensor's error before and after a plan, as a self-contained SVG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from markupsafe import Markup

from mavcal.calib.drawing import Chart, side_by_side
from mavcal.calib.drawing.scale import limits_of
from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import NAMES, ErrorCurve, SensorEffect, amount

BEFORE, AFTER = "#b3261e", "#14713a"
AXES: Final = ("x", "y", "z")
FACES: Final = ("+x", "+y", "+z", "-x", "-y", "-z")
SHADES: Final = ("#b3261e", "#c9731f", "#7a4fb5")
"""Colours of the three axes of a drift before."""


def picture_of(effects: Sequence[SensorEffect], alt_text: str, columns: int | None = None) -> Markup | None:
    """Error curves of the sensors in rows of `columns` (None: one row); None: no sensor has a curve."""
    charts = [_chart(effect, effect.curve) for effect in effects if effect.curve is not None]
    return side_by_side(charts, alt_text, columns=columns) if charts else None


def _chart(effect: SensorEffect, curve: ErrorCurve) -> Chart:
    assert effect.before is not None
    name = f"{NAMES.get(effect.sensor, str(effect.sensor)).capitalize()} {effect.instance + 1}"
    title = f"{name}: {amount(effect.before, effect.unit)} → {amount(effect.after, effect.unit)}"
    reach = max(float(np.abs(curve.before).max()), 3.0 * float(curve.after_sd.max()))
    margin = 0.5 if len(curve.x) <= len(FACES) else 0.0
    x = (float(curve.x[0]) - margin, float(curve.x[-1]) + margin)
    chart = Chart(title, _x_label(effect, curve), curve.label, x, limits_of(np.array([-reach, reach])))
    chart.x_names = {"axis": AXES, "face": FACES}.get(curve.x_label, ())
    if curve.before.ndim == 2:
        for axis, shade in enumerate(SHADES):
            chart.line(curve.x, curve.before[:, axis], shade, f"before, {AXES[axis]}")
        chart.line(curve.x, curve.after_sd, AFTER, "after, ± sd", dashed=True)
        chart.line(curve.x, -curve.after_sd, AFTER, dashed=True)
    elif len(curve.x) <= len(FACES):
        chart.dots(curve.x - 0.12, curve.before, BEFORE, "before", size=4.0)
        chart.bars(curve.x + 0.12, np.zeros(len(curve.x)), curve.after_sd, AFTER, "after, ± sd")
    else:
        chart.line(curve.x, curve.before, BEFORE, "before")
        chart.line(curve.x, curve.after_sd, AFTER, "after, ± sd", dashed=True)
        chart.line(curve.x, -curve.after_sd, AFTER, dashed=True)
    return chart


def _x_label(effect: SensorEffect, curve: ErrorCurve) -> str:
    if curve.x_label == "face":
        return "axis that points up"  # at rest a specific force does
    return curve.x_label if effect.sensor != Sensor.MAG else f"true {curve.x_label}"
