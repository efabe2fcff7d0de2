"""A gap at a glance: the residual that is left is smaller, the largest effects come first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.schema import GapReport, GapVerdict, Inputs, SeriesFit
from mavcal.calib.recording import Sensor
from tests.unit.plots.reading import heading, panels_of

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
    drawn = GapReport(INPUTS, GapVerdict.EXPLAINED, series=made).plot()
    first, spectrum, second, _ = panels_of(drawn)
    assert heading(drawn) == "Gap: explained"
    assert first.title == "gyro 1 y: a_tone"
    assert first.labels == ["time, s", "real less ideal, deg/s"]
    assert second.title == "accel 1 y: a_tone"
    assert [key[2] for key in first.keys] == ["before, 20 deg/s rms", "with the effects, 0.57 deg/s rms"]
    before, after, noise = (spectrum.drawn(n) for n in ("before", "with the effects", "noise of the model"))
    assert noise.dashed
    assert before.y.max() > 20.0 * after.y.max()
    np.testing.assert_allclose(np.median(after.y), noise.y[0], rtol=0.2)


def test_many_effects_are_counted_where_there_is_no_room():
    one = series(Sensor.ACCEL, 0.02, "m/s2")
    many = dataclasses.replace(one, parts={f"an_effect_with_a_name_{n}": one.modelled for n in range(5)})
    first = panels_of(GapReport(INPUTS, GapVerdict.EXPLAINED, series=(many,)).plot())[0]
    assert first.title == "accel 1 y: an_effect_with_a_name_0 and 4 more"


def test_a_report_without_residuals_says_so():
    with pytest.raises(InvalidInputError, match="no residuals to plot"):
        GapReport(INPUTS, GapVerdict.NOT_TESTABLE).plot()
