"""A figure of a fit shows its samples before and after; without matplotlib it says which extra is missing."""

from __future__ import annotations

import builtins
import dataclasses
import io
import subprocess
import sys

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, MissingExtraError
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.noise.allan_fit import fit_allan
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel

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


def saved(figure) -> bytes:
    """A warning while it is drawn is an error, as in every test."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=50)
    return file.getvalue()


def lines(axes) -> dict[str, np.ndarray]:
    return {line.get_label().split(",")[0]: line.get_ydata() for line in axes.lines}


def test_a_compass_has_the_length_of_its_field_and_its_sphere(compass):
    samples, fit = compass
    figure = fit.plot(samples)
    length, sphere, directions = figure.axes
    shown = lines(length)
    assert len(shown["before"]) == 3000  # thinned
    np.testing.assert_allclose(shown["after"], 50.0, rtol=1e-9)
    assert shown["expected 50"][0] == pytest.approx(50.0)  # the model's field, not the mean radius
    assert np.abs(shown["before"] - 50.0).max() > 10.0
    assert sphere.name == "3d"
    assert len(sphere.collections) == 5, "samples before and after, the origin, the ellipsoid and the sphere"
    assert directions.name == "mollweide"
    assert saved(figure).startswith(b"\x89PNG")


def test_an_accelerometer_has_the_length_of_gravity(rng):
    directions = rng.normal(size=(50, 3))
    truth = STANDARD_GRAVITY * directions / np.linalg.norm(directions, axis=1)[:, None]
    samples = channel(Sensor.ACCEL, truth + np.array([0.3, -0.2, 0.1]), "m/s2")
    axes, directions = fitted(samples, TriadModel(np.array([0.3, -0.2, 0.1]))).plot(samples).axes
    assert directions.get_title() == "Directions measured"
    np.testing.assert_allclose(lines(axes)["after"], STANDARD_GRAVITY, rtol=1e-9)
    assert axes.get_ylabel() == "|f|, m/s²"


def test_a_gyro_has_its_rates_in_degrees_about_zero_afterwards():
    samples = channel(Sensor.GYRO, np.tile([0.01, -0.02, 0.03], (20, 1)), "rad/s")
    (axes,) = fitted(samples, TriadModel(np.array([0.01, -0.02, 0.03]))).plot(samples).axes
    shown = lines(axes)
    np.testing.assert_allclose(shown["z before"], np.degrees(0.03))
    np.testing.assert_allclose(shown["z after"], 0.0, atol=1e-12)


def test_a_drift_has_its_curve_with_its_uncertainty_and_the_residuals_of_samples():
    curve = ThermalPolynomial(35.0, 20.0, 60.0, np.array([[1e-4], [2e-4], [-1e-4]]))
    at = np.linspace(20.0, 60.0, 80)
    samples = channel(Sensor.GYRO, curve(at), "rad/s")
    fit = fitted(samples, TriadModel(polynomial=curve))
    (alone,) = fit.plot().axes
    assert lines(alone)["y"][-1] == pytest.approx(np.degrees(2e-4 * 25.0))
    assert len(alone.collections) == 3, "a band of one sd an axis"
    first, second = fit.plot(samples, at).axes
    assert lines(first)["y"][-1] == pytest.approx(np.degrees(2e-4 * 25.0))
    np.testing.assert_allclose(lines(second)["y after"], 0.0, atol=1e-12)
    with pytest.raises(InvalidInputError, match="depends on temperature"):
        fit.plot(samples)
    with pytest.raises(InvalidInputError, match="80 samples need as many temperatures"):
        fit.plot(samples, at[:7])
    assert saved(fit.plot(samples, at))


@pytest.mark.parametrize(("sensor", "unit", "bars"), [(Sensor.GYRO, "rad/s", 3), (Sensor.ACCEL, "m/s2", 6)])
def test_without_samples_it_says_what_the_parameters_correct(sensor, unit, bars):
    fit = fitted(channel(sensor, np.zeros((3, 3)), unit), TriadModel(np.array([0.1, 0.2, 0.3])))
    (axes,) = fit.plot().axes
    heights = [bar.get_height() for bar in axes.patches]
    assert len(heights) == bars
    assert heights[2] == pytest.approx(np.degrees(0.3) if sensor == Sensor.GYRO else 0.3, rel=0.01)


def test_a_compass_that_does_not_know_its_field_asks_for_samples(compass):
    samples, fit = compass
    assert fit.plot().axes
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
    _, residuals = fitted(samples, TriadModel(polynomial=curve)).plot(Recording((samples, thermometer))).axes
    np.testing.assert_allclose(lines(residuals)["x after"], 0.0, atol=1e-12)


def test_noise_has_its_allan_deviation_and_its_spectrum(rng):
    samples = channel(Sensor.GYRO, 0.01 * rng.normal(size=(5000, 3)), "rad/s")
    fit = fit_allan(samples)
    deviation, spectrum = fit.plot(samples).axes
    assert (deviation.get_xscale(), spectrum.get_xscale()) == ("log", "log")
    model = next(line for line in deviation.lines if line.get_label() == "x model")
    white = np.degrees(fit.native["N"][0])
    assert model.get_ydata()[0] == pytest.approx(white * np.sqrt(50.0), rel=0.05)  # at the shortest time, 1/50 s
    dashes = [line.get_ydata()[0] for line in spectrum.lines if line.get_linestyle() == "--"]
    measured = np.median(spectrum.lines[0].get_ydata())
    assert measured == pytest.approx(dashes[0], rel=0.15)
    assert saved(fit.plot(samples))
    assert len(fit.plot().axes) == 1


def test_without_matplotlib_the_extra_is_named(compass, monkeypatch):
    real = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name.startswith("matplotlib"):
            raise ModuleNotFoundError(name)
        return real(name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"pip install 'mavcal\[plot\]'"):
        compass[1].plot()


def test_matplotlib_is_loaded_by_a_plot_alone_and_pyplot_never():
    code = (
        "import sys, numpy as np; from mavcal.calib.fit import FitBuilder; from mavcal.calib.triad import TriadModel\n"
        "assert not any(m.startswith('matplotlib') for m in sys.modules)\n"
        "made = FitBuilder('m', 'accel', 0, 'm/s2', 3).fitted(TriadModel(), np.eye(12), message='', n_used=3,"
        " residual_rms=1.0, condition_number=1.0)\n"
        "made.plot(); assert 'matplotlib.figure' in sys.modules; assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
