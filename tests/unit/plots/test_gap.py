"""A gap at a glance: the residual that is left is smaller, the largest effects come first."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.schema import GapReport, GapVerdict, Inputs, SeriesFit
from mavcal.calib.recording import Sensor

INPUTS = Inputs(None, None, 100.0, 60.0, "pose", 0.1, "", {}, "0")


def series(sensor: Sensor, size: float, unit: str, power: np.ndarray | None = None) -> SeriesFit:
    rng = np.random.default_rng(2)
    t = 7.0 + np.arange(3000) / 100
    noise = 0.01 * rng.normal(size=(3000, 3))
    effect = np.column_stack([0 * t, size * np.sin(2 * np.pi * 5.0 * t), 0 * t])
    return SeriesFit(
        sensor, (1,), t, effect + noise, effect, np.full(3, 0.01), unit, {"a_tone": effect}, power=power
    )  # fmt: skip


def test_the_sensor_with_the_largest_effect_comes_first_on_the_axis_that_it_moves():
    made = (series(Sensor.ACCEL, 0.02, "m/s2"), series(Sensor.GYRO, 0.5, "rad/s", np.full((64, 3), 1e-4)))
    figure = GapReport(INPUTS, GapVerdict.EXPLAINED, series=made).plot()
    first, spectrum, second, _ = figure.axes
    assert first.get_ylabel().startswith("gyro 1 y\nreal less ideal, deg/s")
    assert second.get_ylabel().startswith("accel 1 y")
    assert first.get_title() == "a_tone"
    before, after, dashes = (line.get_ydata() for line in spectrum.lines)
    assert before.max() > 20.0 * after.max()
    np.testing.assert_allclose(np.median(after), dashes[0], rtol=0.2)


def test_a_report_without_residuals_says_so():
    with pytest.raises(InvalidInputError, match="no residuals to plot"):
        GapReport(INPUTS, GapVerdict.NOT_TESTABLE).plot()
