from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.gap.schema import SeriesFit
from mavcal.calib.gap_report import series_plots
from mavcal.calib.gap_report.series_plots import (
    allan_plot,
    axis_of,
    conditions,
    name_of,
    overlay,
    shape_plot,
    spectrum,
    spectrum_plot,
    strip,
)
from mavcal.calib.recording import Sensor
from tests.unit.gap.export.making import effect

N, FS = 1000, 50.0
T = np.arange(N) / FS
WARM = 20.0 + 10.0 * np.sin(0.3 * T)


def series(part, *, noise=0.01, **more):
    """A magnetometer whose only effect is `part` (N, 3)."""
    own = noise * np.random.default_rng(3).normal(size=(N, 3))
    parts = {"mag_hard_iron": part}
    fields = {"sensor": Sensor.MAG, "instances": (1,), "t": T, "residual": part + own, "modelled": part}
    return SeriesFit(**{**fields, "sigma": np.full(3, 0.01), "unit": "uT", "parts": parts, **more})


def column(values, axis=1):
    made = np.zeros((len(values), 3))
    made[:, axis] = values
    return made


def words(picture):
    return [e.text for e in ElementTree.fromstring(picture).iter("text")]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_axis_is_that_on_which_the_effect_is_largest(axis):
    assert axis_of(series(column(WARM, axis)), "mag_hard_iron") == axis
    assert axis_of(series(column(WARM, axis))) == axis


def test_an_axis_counts_in_units_of_its_noise():
    both = column(np.full(N, 1.0), 0) + column(np.full(N, 2.0), 2)
    assert axis_of(series(both)) == 2
    assert axis_of(series(both, sigma=np.array([0.01, 0.01, 0.1]))) == 0


def test_without_an_effect_the_residual_chooses():
    flat = series(np.zeros((N, 3)))
    assert axis_of(replace(flat, residual=column(WARM, 2))) == 2


def test_a_combination_names_its_instances():
    assert name_of(series(column(WARM))) == "mag 1"
    assert name_of(series(column(WARM), instances=(1, 3))) == "mag 1+3"


CURRENT = np.random.default_rng(1).uniform(0.0, 20.0, N)
IDEAL = np.random.default_rng(2).uniform(-40.0, 40.0, (N, 3))


@pytest.mark.parametrize(
    ("part", "label"),
    [
        (0.1 * CURRENT, "current, A"),
        ((WARM - 20.0) ** 2, "temperature, degC"),
        (0.02 * IDEAL[:, 2], "ideal z, uT"),
        (np.sin(T * T), "time, s"),
        (np.full(N, 3.0), "time, s"),  # it follows nothing
    ],
)
def test_an_effect_is_drawn_over_what_it_follows(part, label):
    made = series(column(part), covariates={"temperature": WARM, "current": CURRENT}, ideal=IDEAL)
    assert label in words(shape_plot(made, "mag_hard_iron"))


def test_of_two_equal_reasons_the_first_is_taken():
    made = series(column(CURRENT), covariates={"current": CURRENT, "throttle": CURRENT / 20.0})
    assert "current, A" in words(shape_plot(made, "mag_hard_iron"))


def test_an_effect_that_is_not_there_has_no_picture():
    made = series(column(WARM))
    assert shape_plot(made, "mag_delay") == ""
    assert shape_plot(replace(made, parts={"mag_hard_iron": np.zeros((N, 3))}), "mag_hard_iron") == ""


def test_the_shape_of_one_effect_is_what_the_others_leave():
    """Before and after differ by the effect itself; the other effect is in neither."""
    one, other = column(0.1 * CURRENT), column(np.where(T > 10.0, 50.0, 0.0))
    made = series(one, noise=1e-6)
    made = replace(made, residual=one + other, modelled=one + other, parts={"a": one, "b": other})
    made = replace(made, covariates={"current": CURRENT})
    labels = [float(w) for w in words(shape_plot(made, "a")) if re.fullmatch(r"-?[\d.]+", w or "")]
    assert max(labels) < 25.0  # the step of 50 uT is not drawn
    assert min(labels) == 0.0  # before it is the effect, which is positive; after it nothing


def test_means_of_bins_have_their_intervals():
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 1.0, 20_000)
    middle, mean, half = series_plots._binned(x, 2.0 * x + rng.normal(size=len(x)))
    assert len(middle) == 24
    inside = np.abs(mean - 2.0 * middle) < half
    assert inside.mean() > 0.75
    np.testing.assert_allclose(half, 1.96 / np.sqrt(len(x) / 24), rtol=0.2)


def test_a_bin_with_few_samples_has_no_mean():
    x = np.concatenate([np.zeros(100), [1.0, 1.0]])
    middle, mean, _ = series_plots._binned(x, x)
    assert (middle.tolist(), mean.tolist()) == ([0.0], [0.0])
    middle, _, half = series_plots._binned(np.full(50, 7.0), np.ones(50))
    assert (middle.tolist(), half.tolist()) == ([7.0], [0.0])


def test_a_tone_stands_at_its_frequency_with_its_power():
    hz, density = spectrum(3.0 * np.sin(2 * np.pi * 8.0 * np.arange(20_000) / FS), FS)
    assert hz[np.argmax(density)] == pytest.approx(8.0, rel=0.05)
    assert hz[0] > 0.0
    assert hz[-1] <= 0.5 * FS


def test_short_series_have_no_pictures():
    short = series(column(WARM))
    few = {name: getattr(short, name)[:50] for name in ("t", "residual", "modelled")}
    short = replace(short, **few, parts={"mag_hard_iron": few["modelled"]}, ideal=few["modelled"])
    assert shape_plot(short, "mag_hard_iron") == spectrum_plot(short) == allan_plot(short) == overlay(short) == ""
    assert strip([short], []) == []
    enough = series(column(WARM))
    assert "Spectrum: mag 1, y axis" in words(spectrum_plot(enough))
    assert "Allan deviation: mag 1, y axis" in words(allan_plot(enough))


def test_the_noise_of_the_model_is_drawn_where_it_is_known():
    made = series(column(WARM))
    assert "model's noise" not in words(spectrum_plot(made))
    assert "model's noise" in words(spectrum_plot(replace(made, power=np.full((N, 3), 1e-4))))


def test_a_step_is_marked_in_the_strip_of_its_sensor():
    made = [series(column(WARM)), series(column(WARM), instances=(2,))]
    step = effect("mag_step", (2,), step=(1.0, 0.0, 0.0), time_s=12.0)
    first, second = strip(made, [step])
    assert ("step" in words(first), "step" in words(second)) == (False, True)
    assert "step" not in words(strip(made[:1], [effect("accel_step", (1,), step=(1.0, 0.0, 0.0), time_s=12.0)])[0])


def test_each_condition_is_drawn_once_and_only_where_it_changes():
    made = series(column(WARM), covariates={"temperature": WARM, "throttle": np.full(N, 0.5)})
    again = series(column(WARM), instances=(2,), covariates={"temperature": WARM, "current": CURRENT})
    assert [words(picture)[0] for picture in conditions([made, again])] == ["Temperature", "Current"]


def test_the_overlay_shows_the_seconds_that_move_most():
    burst = np.where((T > 12.0) & (T < 15.0), 5.0, 0.0)
    assert series_plots._busiest(T, burst) == slice(550, 750)  # the first four seconds that hold all of it
    made = series(column(burst), ideal=np.zeros((N, 3)))
    assert {"real", "simulated", "simulated with the effects"} <= set(words(overlay(made)))
    assert overlay(replace(made, ideal=None)) == ""
    assert overlay(replace(made, modelled=np.zeros((N, 3)))) == ""


def test_the_strip_counts_in_units_of_the_noise():
    step = column(np.where(T > 10.0, 0.05, 0.0))  # five times the noise of one axis of three
    t, before = series_plots._energy(series(step), series(step).residual)
    _, after = series_plots._energy(series(step), series(step).residual - step)
    np.testing.assert_allclose(after, 1.0, atol=0.5)
    np.testing.assert_allclose(before[t > 10.5], np.sqrt(1.0 + 25.0 / 3.0), rtol=0.25)
    np.testing.assert_allclose(before[t < 9.5], after[t < 9.5])
    assert t[0] == pytest.approx(T[:8].mean(), abs=0.05)
    assert len(t) == 120


def test_before_and_after_are_both_drawn():
    made = series(column(WARM))
    for picture in (spectrum_plot(made), allan_plot(made)):
        assert {"real less simulated", "with the effects"} <= set(words(picture))
        assert len(list(ElementTree.fromstring(picture).iter("polyline"))) == 2
