"""What is left over beside a model is found in bands, in lines, and where it passes; white noise shows none of it."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.unknown.excess_power import excess_power
from mavcal.calib.recording import Sensor

G, FS, N, SD = Sensor.GYRO, 200.0, 12_000, 0.003


def left_of(change, *, seed=0, **over):
    t = np.arange(N) / FS
    measured = SD * np.random.default_rng(seed).normal(size=(N, 3)) + change(t)
    trace = Trace(G, (0,), t, measured, np.zeros((N, 3)), np.ones(N, dtype=bool), **{"sigma": np.full(3, SD), **over})
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), N / FS), {}, {}))
    return excess_power(model_without_effects(setting))


def spike_at(row):
    def spike(t):
        change = np.zeros((len(t), 3))
        change[row] = 40.0 * SD
        return change

    return spike


@pytest.mark.long
def test_white_noise_leaves_nothing_over():
    assert not any(left_of(lambda t: np.zeros((len(t), 3)), seed=seed) for seed in range(40))


@pytest.mark.parametrize("hz", [23.017, 41.84, 97.3])
def test_a_line_is_found_between_two_bins_too(hz):
    size = SD * np.sqrt(2.0 * 80.0 / N)  # 80 of (delta / sigma)^2 on each axis
    (left,) = left_of(lambda t: size * np.sin(2.0 * np.pi * hz * t + 0.7)[:, None] * [1.0, -1.0, 1.0])
    assert left.text.startswith("a line at")
    assert float(left.text.split()[3]) == pytest.approx(hz, abs=0.02)


def test_a_little_more_noise_on_all_axes_shows_in_all_bands_together():
    extra = 0.3 * SD
    (left,) = left_of(lambda t: extra * np.random.default_rng(5).normal(size=(len(t), 3)))
    assert left.text.endswith("on gyro")
    assert left.text.startswith("power from")
    assert left_of(lambda t: extra * np.random.default_rng(5).normal(size=(len(t), 3)), sigma_dof=500.0) == []


def test_waves_that_come_and_go_are_found_where_no_band_is_loud():
    def chirps(t):
        phase = 2.0 * np.pi * (20.0 * t + 15.0 * np.cumsum(np.sin(2.0 * np.pi * t / 9.0)) / FS)
        return 0.45 * SD * np.sin(phase)[:, None] * [1.0, 0.8, -0.6]

    (left,) = left_of(chirps)
    assert left.sensor is Sensor.GYRO
    assert left.text.startswith(("waves", "power"))


def test_one_spike_is_no_wave():
    assert not any("waves" in left.text for left in left_of(spike_at(6000)))


@pytest.mark.parametrize("seconds", [0.2, 0.6, 2.0])
@pytest.mark.parametrize("at", [13.7, 41.0])
def test_what_passes_once_is_found_with_its_time(seconds, at):
    def passing(t):
        bump = np.exp(-0.5 * ((t - at) / (0.25 * seconds)) ** 2)[:, None] * [1.0, -0.6, 0.8]
        return SD * np.sqrt(150.0 / (bump**2).sum()) * bump

    (left,) = left_of(passing)
    assert left.text.startswith("something that passes at")
    start, within = float(left.text.split()[4]), float(left.text.split()[7])
    assert start <= at <= start + within


def test_noise_that_is_louder_for_a_moment_is_nothing_that_passes():
    def louder(t):
        moment = (t > 20.0) & (t < 21.0)
        return 1.2 * SD * moment[:, None] * np.random.default_rng(7).normal(size=(len(t), 3))

    assert not any("passes" in left.text for left in left_of(louder))
    assert not any("passes" in left.text for at in (0, 6000, 6017, 11_999) for left in left_of(spike_at(at)))


def jolted(*, lasts, outside=False, sensor=Sensor.ACCEL):
    """An accelerometer with a spectrum of another flight, and more noise: at a touchdown, or all the time."""
    rng = np.random.default_rng(3)
    t = np.arange(N) / FS
    touches = (t > 55.0) & (t < 55.4)
    ideal = np.zeros((N, 3)) - [0.0, 0.0, 9.8]
    ideal += 20.0 * touches[:, None] * rng.normal(size=(N, 3))
    more = (4.0 if lasts else 40.0) * SD * rng.normal(size=(N, 3)) * (1.0 if lasts else touches[:, None])
    measured = ideal + SD * rng.normal(size=(N, 3)) + more
    hz = np.linspace(0.0, 0.5 * FS, 50)
    psd = np.full((50, 3), SD**2)
    trace = Trace(sensor, (0,), t, measured, ideal, np.ones(N, dtype=bool), psd=psd, psd_hz=hz, sigma_dof=1e4)
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), N / FS), {}, {}))
    return excess_power(model_without_effects(setting), outside=outside)


def test_what_lasts_as_long_as_a_touchdown_is_no_error_of_the_accelerometer():
    assert jolted(lasts=False) == []
    (left,) = jolted(lasts=True)
    assert left.text.startswith("power from")


def test_jolts_beside_cameras_are_the_sensors_own():
    """Somebody taps at a board: its own units do not tell of it at moments of their own, they are no reference."""
    (left,) = jolted(lasts=False, outside=True)
    assert left.text.startswith("power from")
