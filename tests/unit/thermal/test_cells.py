from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.cells import DriftCells
from mavcal.calib.thermal.fit import PolynomialOptions, fit_drift_data, fit_polynomial

COEFFICIENTS = np.array([[7e-3, 6e-5, 1e-6], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, -2e-6]])
PER_TICK = 12


def warm_up(n):
    return 60.0 - 40.0 * np.exp(-np.arange(n) / (0.4 * n))


def drift(T):
    d = (T - 35.0)[:, None]
    return np.array([0.1, -0.2, 0.05]) + sum(COEFFICIENTS[:, j] * d ** (j + 1) for j in range(3))


def gyro(values):
    return Channel(Sensor.GYRO, 0, np.arange(len(values)) / 50.0, values, "rad/s", Stage.RAW, "test")


def in_cells(channel, limit=2048, span=None):
    cells = DriftCells(channel.values.shape[1], limit=limit)
    for i in range(0, len(channel), PER_TICK):
        cells.add(channel.take(slice(i, i + PER_TICK)), 0 if span is None else int(span[i]))
    return cells


def fitted(cells, T, **options):
    at = np.interp(cells.table().time, np.arange(len(T)) / 50.0, T)
    data = cells.data(at)
    return fit_drift_data(cells.channel, data, data.samples, PolynomialOptions(**options))


@pytest.mark.parametrize("limit", [2048, 100, 40])
def test_cells_give_the_fit_of_the_samples(limit):
    rng = np.random.default_rng(1)
    T = warm_up(6000)
    channel = gyro(drift(T) + 0.02 * rng.normal(size=(6000, 3)))
    whole, cells = fit_polynomial(channel, T), in_cells(channel, limit)
    assert len(cells) <= 2 * limit
    counts = cells.table().count
    assert (counts[:-1] == counts[0]).all()  # cells of one length
    summed = fitted(cells, T)
    assert np.abs((summed.values - whole.values)[[0, 1, 2]] / whole.sd[:3]).max() < 0.1
    assert np.abs((summed.values[12:] - whole.values[12:]) / whole.sd[12:]).max() < 0.1
    assert summed.sd[12:] == pytest.approx(whole.sd[12:], rel=0.3)
    assert summed.residual_rms == pytest.approx(whole.residual_rms, rel=5e-3)
    assert (summed.n_samples, summed.n_used) == (6000, 6000)


@pytest.mark.parametrize("noise", [0.5, 0.2])
@pytest.mark.parametrize("limit", [2048, 60])
def test_coarse_bins_are_counted(raw_channel, noise, limit):
    rng = np.random.default_rng(2)
    T = warm_up(4800)
    values = drift(T) + noise * 0.01 * rng.normal(size=(4800, 3))
    coarse = raw_channel(Sensor.GYRO, np.arange(4800) / 50.0, values, "rad/s", quantum=0.01)
    whole, summed = fit_polynomial(coarse, T), fitted(in_cells(coarse, limit), T)
    assert summed.undetermined == whole.undetermined
    known = whole.sd > 0
    assert np.abs((summed.values - whole.values)[known] / whole.sd[known]).max() < 0.5
    assert np.abs(np.log(summed.sd[known] / whole.sd[known])).max() < 1.0


@pytest.mark.long
def test_an_hour_takes_the_memory_of_its_first_minutes(raw_channel):
    rng = np.random.default_rng(3)
    cells = DriftCells(limit=256)
    sizes = []
    tracemalloc.start()
    for k in range(3600):
        t = 0.25 * k + 0.02 * np.arange(PER_TICK)
        values = 0.001 * k / 3600 + 4e-4 * rng.normal(size=(PER_TICK, 3))
        cells.add(raw_channel(Sensor.GYRO, t, values, "rad/s", quantum=1e-3))
        if k % 50 == 0:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert len(cells) <= 512
    assert max(sizes[36:]) < 1.3 * max(sizes[:36]) < 1e6
    assert cells.table().count.sum() == 3600 * PER_TICK


def test_bins_of_fine_noise_are_given_up(raw_channel):
    rng = np.random.default_rng(4)
    values = np.array([9.8, 0.0, -9.8]) + 0.03 * rng.normal(size=(6000, 3))
    cells = in_cells(raw_channel(Sensor.ACCEL, np.arange(6000) / 50.0, values, "m/s2", quantum=0.01))
    x, y, z = cells.bins()
    assert x is None
    assert z is None
    assert y.counts.sum() == 6000  # near the bin around zero, which is wide


def test_spans_are_never_joined():
    T = warm_up(2400)
    span = np.repeat([0, 1, 2], 800)
    cells = in_cells(gyro(drift(T)), limit=8, span=span)
    table = cells.table()
    assert set(table.span) == {0, 1, 2}
    assert table.count.sum() == 2400
    assert (np.diff(table.time) > 0).all()
    assert table.count.max() <= 4.0 * PER_TICK * 12
    many = in_cells(gyro(drift(T)), limit=8, span=np.arange(2400))
    assert len(many) == 200


@given(seed=st.integers(0, 1000), limit=st.integers(4, 30))
def test_joining_keeps_the_sums(seed, limit):
    values = np.random.default_rng(seed).normal(size=(700, 3)) + np.array([1.0, 2.0, 3.0])
    table = in_cells(gyro(values), limit).table()
    assert table.count @ table.mean == pytest.approx(values.sum(axis=0))
    total = table.squares.sum(axis=0) + table.count @ (table.mean - values.mean(axis=0)) ** 2
    assert total == pytest.approx(((values - values.mean(axis=0)) ** 2).sum(axis=0))


def test_rows_may_be_left_out_and_lowered(raw_channel):
    values = np.random.default_rng(5).normal(size=(240, 3))
    coarse = raw_channel(Sensor.GYRO, np.arange(240) / 50.0, values, "rad/s", quantum=1.0)
    data = in_cells(coarse).data(np.linspace(20.0, 40.0, 20))
    half = data.rows(np.arange(20) % 2 == 1)
    assert half.samples == 120
    assert half.bins(0).counts.sum() == 120
    assert half.bins(0).rows.max() == 9
    lower = data.lowered(np.full((20, 3), 0.25))
    assert data.bins(1).values - lower.bins(1).values == pytest.approx(0.25)
    assert data.y - lower.y == pytest.approx(0.25)


def test_other_columns_are_an_error_and_no_samples_nothing():
    cells = DriftCells()
    cells.add(gyro(np.zeros((0, 3))))
    assert len(cells) == 0
    with pytest.raises(InvalidInputError, match="2 columns in cells of 3"):
        cells.add(gyro(np.zeros((5, 2))))
