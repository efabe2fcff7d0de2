"""A picture of a fit shows its samples before and after, as a person reads it off the axes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.noise.allan_fit import fit_allan
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from tests.unit.plots.reading import heading, panels_of

OFFSET = np.array([12.0, -7.0, 3.0])


def channel(sensor: Sensor, values: np.ndarray, unit: str) -> Channel:
    return Channel(sensor, 0, 5.0 + np.arange(len(values)) / 50, values, unit, Stage.RAW, "test")


def fitted(of: Channel, model: TriadModel, quality: dict[str, float] | None = None) -> FitResult:
    size = 12 if model.polynomial is None else 12 + model.polynomial.coefficients.size
    return FitBuilder.of("a-method", of).fitted(
        model, 1e-4 * np.eye(size), message="", n_used=len(of), residual_rms=0.1, condition_number=1.0,
        quality=quality or {},
    )  # fmt: skip


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def compass(rng):
    directions = rng.normal(size=(6000, 3))
    truth = 50.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    samples = channel(Sensor.MAG, truth + OFFSET, "uT")
    return samples, fitted(samples, TriadModel(OFFSET), {"radius": 51.0, "field_ratio": 1.02})


def test_a_compass_has_the_length_of_its_field_its_sphere_and_its_directions(compass):
    samples, fit = compass
    drawn = fit.plot(samples)
    length, sphere, directions = panels_of(drawn)
    assert heading(drawn) == "Compass 1 by a-method: before and after"
    assert length.labels == ["time, s", "|B|, µT"]
    before, after = length.drawn("before"), length.drawn("after")
    assert len(before.y) == 3000  # thinned
    np.testing.assert_allclose(after.y, 50.0, atol=0.1)
    assert np.abs(before.y - 50.0).max() > 10.0
    assert length.drawn("expected 50").y[0] == pytest.approx(50.0, abs=0.1)  # the model's field, not the mean radius
    assert length.drawn("expected 50").dashed
    assert sphere.title == "Ellipsoid before, sphere after"
    assert sorted(sphere.labels) == ["x, µT", "y, µT", "z, µT"]
    assert [(key[1], key[2]) for key in sphere.keys] == [(True, "before"), (True, "after")]
    assert len(sphere.marks) == 5, "the ellipsoid and the sphere, samples before and after, the origin"
    assert directions.title == "Directions measured"
    assert set(directions.texts) >= {"+x", "+y", "+z", "-x", "-y", "-z"}


def test_directions_say_how_much_of_the_sphere_they_cover(compass):
    samples, _ = compass
    fit = fitted(samples, TriadModel(OFFSET), {"radius": 50.0, "coverage": 0.914})
    assert panels_of(fit.plot(samples))[2].title == "Directions measured, 91 % of the sphere"


def test_an_accelerometer_has_the_length_of_gravity_and_its_directions(rng):
    directions = rng.normal(size=(50, 3))
    truth = STANDARD_GRAVITY * directions / np.linalg.norm(directions, axis=1)[:, None]
    samples = channel(Sensor.ACCEL, truth + np.array([0.3, -0.2, 0.1]), "m/s2")
    length, sphere = panels_of(fitted(samples, TriadModel(np.array([0.3, -0.2, 0.1]))).plot(samples))
    assert sphere.title == "Directions measured"
    np.testing.assert_allclose(length.drawn("after").y, STANDARD_GRAVITY, atol=0.01)
    assert length.labels[1] == "|f|, m/s²"


def test_a_gyro_has_its_rates_in_degrees_about_zero_afterwards():
    samples = channel(Sensor.GYRO, np.tile([0.01, -0.02, 0.03], (20, 1)), "rad/s")
    (rates,) = panels_of(fitted(samples, TriadModel(np.array([0.01, -0.02, 0.03]))).plot(samples))
    assert rates.labels == ["time, s", "rate, deg/s"]
    np.testing.assert_allclose(rates.drawn("z before").y, np.degrees(0.03), atol=0.02)
    np.testing.assert_allclose(rates.drawn("z after").y, 0.0, atol=0.02)


def test_a_drift_has_its_curve_with_its_uncertainty_and_the_residuals_of_samples():
    curve = ThermalPolynomial(35.0, 20.0, 60.0, np.array([[1e-4], [2e-4], [-1e-4]]))
    at = np.linspace(20.0, 60.0, 80)
    samples = channel(Sensor.GYRO, curve(at), "rad/s")
    fit = dataclasses.replace(fitted(samples, TriadModel(polynomial=curve)), covariance=1e-12 * np.eye(15))
    (alone,) = panels_of(fit.plot())
    assert alone.labels == ["temperature, °C", "drift, deg/s"]
    assert alone.drawn("y").y[-1] == pytest.approx(np.degrees(2e-4 * 25.0), abs=0.003)
    assert [mark.tag for mark in alone.marks].count("polygon") == 3, "a band of one sd an axis"
    first, second = panels_of(fit.plot(samples, at))
    assert first.drawn("y").y[-1] == pytest.approx(np.degrees(2e-4 * 25.0), abs=0.003)
    np.testing.assert_allclose(second.drawn("y after").y, 0.0, atol=0.003)
    with pytest.raises(InvalidInputError, match="depends on temperature"):
        fit.plot(samples)
    with pytest.raises(InvalidInputError, match="80 samples need as many temperatures"):
        fit.plot(samples, at[:7])


@pytest.mark.parametrize(("sensor", "unit", "bars"), [(Sensor.GYRO, "rad/s", 3), (Sensor.ACCEL, "m/s2", 6)])
def test_without_samples_it_says_what_the_parameters_correct(sensor, unit, bars):
    fit = fitted(channel(sensor, np.zeros((3, 3)), unit), TriadModel(np.array([0.1, 0.2, 0.3])))
    (shown,) = panels_of(fit.plot())
    heights = shown.drawn("before").y
    assert len(heights) == bars
    assert heights[2] == pytest.approx(np.degrees(0.3) if sensor == Sensor.GYRO else 0.3, rel=0.02)
    assert len(shown.drawn("after").y) == bars


def test_a_compass_that_does_not_know_its_field_asks_for_samples(compass):
    samples, fit = compass
    assert len(panels_of(fit.plot())) == 1
    with pytest.raises(InvalidInputError, match="plot it with its samples"):
        fitted(samples, TriadModel(OFFSET)).plot()


def test_what_is_no_sample_of_the_fit_is_refused(compass):
    samples, fit = compass
    with pytest.raises(InvalidInputError, match="samples of gyro 1, the fit is of mag 1"):
        fit.plot(channel(Sensor.GYRO, np.zeros((3, 3)), "rad/s"))
    with pytest.raises(InvalidInputError, match="in counts, the fit in uT"):
        fit.plot(channel(Sensor.MAG, np.zeros((3, 3)), "counts"))
    with pytest.raises(InvalidInputError, match="no samples"):
        fit.plot(channel(Sensor.MAG, np.zeros((0, 3)), "uT"))
    with pytest.raises(InvalidInputError, match="nothing to plot: too little"):
        FitBuilder.of("a-method", samples).refused("too little").plot(samples)


def test_samples_that_the_firmware_has_corrected_are_refused(compass):
    samples, fit = compass
    corrected = dataclasses.replace(samples, stage=Stage.CORRECTED)
    with pytest.raises(InvalidInputError, match=r"mag 1 are corrected, the fit is of raw ones: plot .*bare"):
        fit.plot(corrected)
    assert dataclasses.replace(fit, relative=True).plot(corrected)


def test_a_recording_stands_for_its_channel_and_its_thermometer():
    curve = ThermalPolynomial(35.0, 20.0, 60.0, np.array([[1e-4], [2e-4], [-1e-4]]))
    at = np.linspace(20.0, 60.0, 80)
    samples = channel(Sensor.GYRO, curve(at), "rad/s")
    thermometer = Channel(Sensor.TEMPERATURE, 0, samples.t[::79], at[::79], "degC", Stage.RAW, "test")
    _, rates = panels_of(fitted(samples, TriadModel(polynomial=curve)).plot(Recording((samples, thermometer))))
    np.testing.assert_allclose(rates.drawn("x after").y, 0.0, atol=0.003)


def test_noise_has_its_allan_deviation_and_its_spectrum(rng):
    samples = channel(Sensor.GYRO, 0.01 * rng.normal(size=(5000, 3)), "rad/s")
    fit = fit_allan(samples)
    deviation, spectrum = panels_of(fit.plot(samples))
    assert deviation.labels == ["averaging time, s", "Allan deviation, deg/s"]
    assert spectrum.labels == ["frequency, Hz", "deg/s / √Hz"]
    white = np.degrees(fit.native["N"][0])
    assert deviation.drawn("x model").y[0] == pytest.approx(white * np.sqrt(50.0), rel=0.05)  # at 1/50 s
    assert deviation.drawn("x measured").y[0] == pytest.approx(white * np.sqrt(50.0), rel=0.1)
    dashes = [line.y[0] for line in spectrum.lines if line.dashed]
    assert len(dashes) == 3
    assert np.median(spectrum.drawn("x").y) == pytest.approx(dashes[0], rel=0.15)
    assert len(panels_of(fit.plot())) == 1
