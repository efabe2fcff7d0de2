from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read
from mavcal.calib.methods import METHODS
from mavcal.calib.noise.allan import FLICKER, fit_noise, octaves, overlapping_deviation
from mavcal.calib.noise.allan_fit import fit_allan
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage
from mavcal.calib.report import to_json
from tests.examples import examples

RATE = 50.0


def coloured(rng, n, N=0.0, B=0.0, K=0.0, rate=RATE):
    """Noise of a known two-sided spectrum N^2 + B^2/(2 pi f) + K^2/(2 pi f)^2, cut out of a longer period."""
    f = np.fft.rfftfreq(4 * n, 1.0 / rate)[1:]
    spectrum = N**2 + B**2 / (2 * np.pi * f) + K**2 / (2 * np.pi * f) ** 2
    lines = np.sqrt(spectrum * rate * 2 * n) * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f)))
    return np.fft.irfft(np.concatenate([[0.0], lines]), 4 * n)[:n]


def channel(values, sensor=Sensor.GYRO, unit="rad/s", t=None):
    values = np.asarray(values, dtype=float)
    values = np.column_stack([values] * 3) if values.ndim == 1 else values
    t = np.arange(len(values)) / RATE if t is None else t
    return Channel(sensor, 0, t, values, unit, Stage.RAW, "test")


def plainly(y, rate, m):
    """The definition: half the mean square of the difference of neighbouring averages, from every start."""
    means = np.convolve(y, np.ones(m) / m, mode="valid")
    return np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2))


def test_it_is_the_definition():
    y = np.random.default_rng(1).normal(size=700) + np.linspace(0.0, 3.0, 700) + 1e6
    table = overlapping_deviation(y, 10.0, np.array([1, 2, 5, 40, 117, 350]))
    assert table.tau == pytest.approx([0.1, 0.2, 0.5, 4.0, 11.7, 35.0])
    assert table.adev == pytest.approx([plainly(y, 10.0, int(m)) for m in table.m], rel=1e-9)


def test_the_published_example_of_nbs14():
    """Riley, Handbook of Frequency Stability Analysis (NIST SP 1065), table 31: overlapping, 1000 points."""
    n, x = 1234567890, []
    for _ in range(1000):
        x.append(n / 2147483647)
        n = 16807 * n % 2147483647
    table = overlapping_deviation(np.array(x), 1.0, np.array([1, 10, 100]))
    assert table.adev == pytest.approx([2.922319e-01, 9.159953e-02, 3.241343e-02], rel=1e-6)


def test_chunks_do_not_matter(monkeypatch):
    y = np.random.default_rng(2).normal(size=3000)
    whole = overlapping_deviation(y, RATE, octaves(3000))
    monkeypatch.setattr("mavcal.calib.noise.allan._CHUNK", 101)
    assert overlapping_deviation(y, RATE, octaves(3000)).adev == pytest.approx(whole.adev, rel=1e-12)


@pytest.mark.sampled
@pytest.mark.parametrize(("N", "B", "K"), [(0.01, 0.0, 0.0), (0.01, 0.005, 0.0), (0.01, 0.0, 0.003)])
def test_each_noise_is_found_within_its_sd(N, B, K):
    rng = np.random.default_rng(3)
    z, upper = [], []
    for _ in range(40):
        fit = fit_noise(overlapping_deviation(coloured(rng, 8192, N, B, K), RATE, octaves(8192)), 8192)
        z.append((fit.values[0] - N) / fit.sd[0])
        upper.append(fit.upper >= [N, B, K])
    assert 0.4 < np.mean(np.square(z)) < 1.5
    assert np.mean(upper) > 0.85


@pytest.mark.long
def test_white_noise_is_known_as_well_as_it_can_be():
    rng = np.random.default_rng(4)
    n = 4096
    found = [fit_noise(overlapping_deviation(rng.normal(size=n), 1.0, octaves(n)), n) for _ in range(80)]
    bound = 1.0 / np.sqrt(2 * n)  # of a standard deviation from n samples
    assert np.std([f.values[0] for f in found]) < 1.25 * bound
    assert np.mean([f.sd[0] for f in found]) == pytest.approx(bound, rel=0.3)


def test_the_bias_instability_is_the_flat_part():
    y = coloured(np.random.default_rng(5), 1 << 17, N=1e-3, B=5e-3)
    fit = fit_noise(overlapping_deviation(y, RATE, octaves(len(y))), len(y))
    assert fit.values[1] == pytest.approx(5e-3, rel=0.05)
    assert fit.model.min() == pytest.approx(np.sqrt(FLICKER) * 5e-3, rel=0.1)


def test_another_route_agrees():
    rng = np.random.default_rng(6)
    y = coloured(rng, 1 << 15, 0.01, 0.004, 0.002)
    table = overlapping_deviation(y, RATE, octaves(len(y)))
    fit = fit_noise(table, len(y))
    design = np.column_stack([1.0 / table.tau, np.full(len(table.tau), FLICKER), table.tau / 3.0])
    weight = np.sqrt(table.terms / table.m) / table.adev**2
    rough = np.sqrt(nnls(design * weight[:, None], weight * table.adev**2)[0])
    assert fit.values[0] == pytest.approx(rough[0], rel=0.02)
    assert np.abs(fit.values[2] - rough[2]) < 3.0 * np.nan_to_num(fit.sd[2], nan=fit.upper[2])


@settings(max_examples=examples(20))
@given(scale=st.floats(1e-5, 1e5), shift=st.floats(-1e3, 1e3), factor=st.floats(0.1, 100.0))
def test_another_unit_another_offset_and_another_clock(scale, shift, factor):
    y = coloured(np.random.default_rng(7), 4096, 0.01, 0.004)
    one = fit_noise(overlapping_deviation(y, RATE, octaves(4096)), 4096)
    other = fit_noise(overlapping_deviation(scale * (y + shift), RATE * factor, octaves(4096)), 4096)
    assert other.values[0] / scale * np.sqrt(factor) == pytest.approx(one.values[0], rel=1e-6)
    assert other.values[1] / scale == pytest.approx(one.values[1], rel=1e-4)


def test_a_low_pass_is_recognised_and_the_slow_part_is_fitted():
    white = coloured(np.random.default_rng(8), 1 << 16, 0.01)
    smooth = np.convolve(white, np.exp(-np.arange(300) / 40.0) / 40.0, mode="valid")
    fit = fit_allan(channel(smooth))
    assert fit.status == FitStatus.OK
    assert fit.native["low_pass"] == [True, True, True]
    assert abs(fit.native["N"][0] - 0.01) < 3.0 * fit.native["sd"]["N"][0] < 0.003
    assert 0.5 < fit.native["model_from"][0] < 12.0
    assert any("low-pass filtered" in w for w in fit.warnings)
    assert fit_allan(channel(white)).native["low_pass"] == [False] * 3


def test_the_table_and_the_json():
    fit = fit_allan(channel(coloured(np.random.default_rng(9), 8192, 0.01)))
    assert fit.undetermined == fit.names
    assert set(fit.movements) == set(fit.names)
    assert (fit.model.matrix == np.eye(3)).all()
    assert fit.native["K"] == [None] * 3
    assert fit.native["upper"]["K"][0] > 0.0
    assert fit.native["read_off"][0]["N"] == pytest.approx(0.01, rel=0.1)
    assert fit.native["holds"]["N"][0][0] == pytest.approx(1 / RATE)
    assert fit.quality["attitude_sd_deg_per_min"] == pytest.approx(np.degrees(0.01 * np.sqrt(60.0)), rel=0.2)
    assert fit.quality["p_value"] > 1e-3
    document = json.loads(json.dumps(to_json(fit), allow_nan=False))
    assert len(document["native"]["tau"]) == len(document["native"]["adev"][2])


def test_missing_samples_and_gaps():
    rng = np.random.default_rng(10)
    y, t = coloured(rng, 8192, 0.01), np.arange(8192) / RATE
    keep = rng.random(8192) > 0.004
    few = fit_allan(channel(y[keep], t=t[keep]))
    assert few.native["N"][0] == pytest.approx(0.01, rel=0.05)
    assert any("straight lines" in w for w in few.warnings)
    split = t + np.where(np.arange(8192) > 5000, 100.0, 0.0)
    cut = fit_allan(channel(y, t=split))
    assert cut.n_used == 5001
    assert any("longest" in w for w in cut.warnings)


def test_a_touch_is_told():
    y = coloured(np.random.default_rng(11), 8192, 0.01)
    y[4000:4040] += 3.0
    [said] = [w for w in fit_allan(channel(y)).warnings if "disturbed" in w]
    assert "79 s" in said or "80 s" in said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t, y: (t[:20], y[:20]), "20 finite samples"),
        (lambda t, y: (t, np.full_like(y, 3.0)), "constant value"),
        (lambda t, y: (t[::-1], y), "backwards"),
        (lambda t, y: (np.zeros_like(t), y), "share their time stamp"),
        (lambda t, y: (np.cumsum(np.random.default_rng(0).exponential(0.02, len(t))), y), "no even rate"),
        (lambda t, y: (t, np.full_like(y, np.nan)), "0 finite samples"),
    ],
)
def test_what_no_noise_can_be_told_from_is_refused(change, says):
    t, y = change(np.arange(1000) / RATE, np.random.default_rng(12).normal(size=1000))
    fit = fit_allan(channel(y, t=t))
    assert fit.status == FitStatus.REFUSED
    assert says in fit.message


def test_an_axis_that_is_constant_is_named():
    y = np.random.default_rng(13).normal(size=(1000, 3)) * [1.0, 0.0, 1.0]
    fit = fit_allan(channel(y))
    assert fit.status == FitStatus.PARTIAL
    assert fit.native["N"][1] is None
    assert any(w.startswith("y reads one constant value") for w in fit.warnings)


def test_impossible_averaging_is_an_error():
    with pytest.raises(InvalidInputError, match="needs 120 samples"):
        overlapping_deviation(np.arange(100.0), 1.0, np.array([60]))
    with pytest.raises(InvalidInputError, match="not finite"):
        overlapping_deviation(np.array([1.0, np.nan]), 1.0, np.array([1]))
    with pytest.raises(InvalidInputError, match="three axes"):
        fit_allan(Channel(Sensor.GYRO, 0, np.arange(9.0), np.zeros((9, 1)), "rad/s", Stage.RAW, "test"))


def test_the_method_takes_the_sensor_that_is_asked_for():
    y = np.random.default_rng(14).normal(size=(1000, 3))
    both = Recording((channel(y), channel(y, Sensor.ACCEL, "m/s2")))
    assert [f.sensor for f in METHODS["allan"].run(both)] == [Sensor.ACCEL, Sensor.GYRO]
    assert [f.sensor for f in METHODS["allan"].run(both, {"sensor": "gyro"})] == [Sensor.GYRO]
    untimed = Recording(both.channels, events=(Event(0.0, "no_time", "rows"),))
    with pytest.raises(InvalidInputError, match="--rate"):
        METHODS["allan"].run(untimed)


@pytest.mark.shared
def test_a_phone_behind_its_low_pass(shared_data):
    recording = read(
        shared_data / "allan_galaxy_s5" / "galaxy_s5_static_10Hz.npz",
        mapping={f"accel_{a}": f"acc_mps2_{k}" for k, a in enumerate("xyz")},
        rate=10.0,
    )
    (fit,) = METHODS["allan"].run(recording)
    assert fit.native["low_pass"] == [True] * 3
    assert all(6.0 < start < 15.0 for start in fit.native["model_from"])  # the deviation rises from 0.1 s to 1 s
    assert fit.native["N"] == pytest.approx([0.0110, 0.0107, 0.0174], rel=0.05)
    assert fit.quality["p_value"] > 1e-3
