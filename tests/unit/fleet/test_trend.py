from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.fleet.record import BIAS_LIMITS, BiasObservation
from mavcal.calib.fleet.trend import DAY_S, HORIZON_D, LEAST_SPREAD_DEGC, MOST, Quantity, Trend, bias_trend
from mavcal.calib.preflight import limits
from mavcal.calib.recording import Sensor

SD = (0.001, 0.001, 0.001)


def seen(day: float, x: float = 0.0, *, t: float | None = 25.0, applied: bool = True) -> BiasObservation:
    return BiasObservation(day * DAY_S, (x, 0.0, 0.0), SD, t, applied)


def drifting(per_day: float, n: int, seed: int = 1, warm: float = 0.0) -> list[BiasObservation]:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n, 3)) * SD
    temperatures = 25.0 + warm * np.where(np.arange(n) % 3 == 1, 1.0, 0.0)
    return [
        BiasObservation(
            50.0 * i * DAY_S,
            (50.0 * i * per_day + 0.004 * (temperatures[i] - 25.0) + e[0], float(e[1]), float(e[2])),
            SD,
            float(temperatures[i]),
        )
        for i, e in enumerate(noise)
    ]


def open_of(trend: Trend) -> dict[Quantity, str]:
    return {one.quantity: one.why for one in trend.open}


def test_the_limits_are_those_of_the_preflight_in_the_unit_of_the_domain() -> None:
    assert BIAS_LIMITS[Sensor.GYRO].limit is limits.GYRO_REST
    assert BIAS_LIMITS[Sensor.GYRO].value == pytest.approx(np.radians(limits.GYRO_REST.value))
    assert BIAS_LIMITS[Sensor.ACCEL].value == limits.ACCEL_FORCE.value
    assert BIAS_LIMITS[Sensor.MAG].value == limits.COMPASS_FIELD.value


def test_a_steady_drift_is_found_and_dated() -> None:
    trend = bias_trend(drifting(0.001, 8), 0.5)
    assert trend.per_year is not None
    x, y, _ = trend.per_year
    assert x.low < 0.36525 < x.high
    assert y.low < 0.0 < y.high
    assert x.high - x.low < 0.1
    assert trend.leaving is not None
    assert trend.leaving.earliest is not None
    assert trend.leaving.latest is not None
    truth = (350.0 + 500.0) * DAY_S
    assert trend.leaving.earliest < truth < trend.leaving.latest
    assert trend.leaving.earliest <= (trend.leaving.middle or 0.0) <= trend.leaving.latest


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_calibrations_determine_no_drift_and_say_how_many_are_lacking(n: int) -> None:
    trend = bias_trend([seen(100.0 * i, 0.1 * i) for i in range(n)], 0.5)
    assert (trend.n, trend.per_year, trend.per_degc, trend.leaving) == (n, None, None, None)
    assert f"{3 - n} more needed" in open_of(trend)[Quantity.TIME]
    assert open_of(trend).keys() == set(Quantity)


def test_two_calibrations_at_one_temperature_determine_no_slope_with_it() -> None:
    trend = bias_trend([seen(0.0), seen(100.0)], 0.5)
    assert trend.per_degc is None
    told = open_of(trend)[Quantity.TEMPERATURE]
    assert all(token in told for token in ("2 measurements", "0.0 degC", f"{LEAST_SPREAD_DEGC:.0f} degC away"))


def test_one_calibration_is_not_told_of_as_several() -> None:
    told = open_of(bias_trend([seen(0.0)], 0.5))[Quantity.TEMPERATURE]
    assert "1 measurement " in told
    assert "within" not in told
    assert f"{LEAST_SPREAD_DEGC:.0f} degC away" in told


def test_many_calibrations_at_one_temperature_determine_none_either() -> None:
    trend = bias_trend(drifting(0.001, 8), 0.5)
    assert trend.per_degc is None
    assert open_of(trend).keys() == {Quantity.TEMPERATURE}


def test_three_at_different_temperatures_cannot_tell_time_from_temperature() -> None:
    trend = bias_trend(drifting(0.001, 3, warm=20.0), 0.5)
    assert (trend.per_year, trend.per_degc) == (None, None)
    assert "drift and slope with temperature" in open_of(trend)[Quantity.TEMPERATURE]


def test_temperatures_that_went_evenly_with_time_are_left_out() -> None:
    rng = np.random.default_rng(1)
    found = [seen(20.0 * i, float(x), t=20.0 + 2.0 * i) for i, x in enumerate(0.01 * rng.standard_normal(8))]
    trend = bias_trend(found, 0.5)
    assert trend.per_degc is None
    assert "nothing tells the two apart" in open_of(trend)[Quantity.TEMPERATURE]
    assert trend.per_year is not None


def test_a_slope_with_temperature_is_found_beside_the_drift() -> None:
    trend = bias_trend(drifting(0.001, 9, warm=20.0), 0.5)
    assert trend.per_degc is not None
    assert trend.per_degc[0].low < 0.004 < trend.per_degc[0].high
    assert trend.per_degc[0].high - trend.per_degc[0].low < 0.002


def test_a_temperature_that_is_not_known_is_said() -> None:
    observations = drifting(0.001, 6, warm=20.0)
    observations[2] = dataclasses.replace(observations[2], temperature=None)
    trend = bias_trend(observations, 0.5)
    assert trend.per_degc is None
    assert open_of(trend).keys() == {Quantity.TEMPERATURE}
    assert "1 of" in open_of(trend)[Quantity.TEMPERATURE]
    assert "6 measurements" in open_of(trend)[Quantity.TEMPERATURE]


def test_measurements_of_one_hour_determine_no_drift() -> None:
    trend = bias_trend([seen(i / 96.0) for i in range(5)], 0.5)
    assert trend.per_year is None
    assert "1.0 h" in open_of(trend)[Quantity.TIME]


def test_without_a_calibration_in_force_there_is_no_date() -> None:
    trend = bias_trend([dataclasses.replace(o, applied=False) for o in drifting(0.001, 5)], 0.5)
    assert trend.per_year is not None
    assert trend.leaving is None
    assert "No calibration is in force" in open_of(trend)[Quantity.LEAVING]


def test_what_was_read_after_the_last_calibration_counts_and_the_limit_is_from_that_calibration() -> None:
    observations = [dataclasses.replace(o, applied=i == 0) for i, o in enumerate(drifting(0.001, 8))]
    leaving = bias_trend(observations, 0.5).leaving
    assert leaving is not None
    assert leaving.earliest is not None
    assert leaving.latest is not None
    assert leaving.earliest < 500.0 * DAY_S < leaving.latest


def test_a_bias_that_is_out_already_left_at_its_last_measurement() -> None:
    observations = [dataclasses.replace(o, applied=i == 0) for i, o in enumerate(drifting(0.01, 8))]
    leaving = bias_trend(observations, 0.5).leaving
    assert leaving is not None
    assert leaving.earliest == leaving.latest == observations[-1].at


def test_a_steady_sensor_leaves_its_limit_later_than_can_be_told() -> None:
    leaving = bias_trend(drifting(0.0, 8), 0.5).leaving
    assert leaving is not None
    assert (leaving.earliest, leaving.middle, leaving.latest) == (None, None, None)


def test_a_restless_sensor_is_dated_sooner_and_less_surely_than_a_steady_drift() -> None:
    steady = bias_trend(drifting(0.0005, 8), 0.5).leaving
    steps = 0.03 * np.cumsum([0.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0, 0.0])
    restless = [
        dataclasses.replace(o, bias=(o.bias[0] + e, o.bias[1], o.bias[2]))
        for o, e in zip(drifting(0.0005, 8), steps.tolist(), strict=True)
    ]
    wandering = bias_trend(restless, 0.5).leaving
    assert steady is not None
    assert wandering is not None
    assert (wandering.earliest or np.inf) < (steady.earliest or np.inf)
    assert (wandering.latest or np.inf) >= (steady.latest or np.inf)


def test_the_newest_measurements_count_if_there_are_too_many() -> None:
    many = [dataclasses.replace(o, applied=i == 0) for i, o in enumerate(drifting(0.001, MOST + 30))]
    assert bias_trend(many, 0.5).n == MOST


def test_what_is_foretold_lies_within_the_horizon() -> None:
    observations = drifting(0.0001, 6)
    leaving = bias_trend(observations, 0.5).leaving
    assert leaving is not None
    last = observations[-1].at
    for at in (leaving.earliest, leaving.middle, leaving.latest):
        assert at is None or last <= at <= last + HORIZON_D * DAY_S


BIASES = st.lists(st.floats(-0.2, 0.2), min_size=4, max_size=9)


@given(biases=BIASES, shift=st.floats(-5.0, 5.0), later=st.floats(0.0, 1e4))
def test_a_shift_of_bias_or_time_changes_no_slope(biases: list[float], shift: float, later: float) -> None:
    there = [seen(40.0 * i, x) for i, x in enumerate(biases)]
    moved = [seen(later + 40.0 * i, x + shift) for i, x in enumerate(biases)]
    a, b = bias_trend(there, 0.5), bias_trend(moved, 0.5)
    assert a.per_year is not None
    assert b.per_year is not None
    for one, other in zip(a.per_year, b.per_year, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-3 + 0.02 * (one.high - one.low))


@given(biases=BIASES)
def test_the_order_of_measurements_does_not_matter(biases: list[float]) -> None:
    there = [seen(40.0 * i, x) for i, x in enumerate(biases)]
    assert bias_trend(there, 0.5) == bias_trend(there[::-1], 0.5)


@pytest.mark.long
@given(biases=BIASES, wider=st.floats(1.0, 10.0))
def test_a_wider_limit_is_never_left_sooner(biases: list[float], wider: float) -> None:
    there = [seen(40.0 * i, x) for i, x in enumerate(biases)]
    near, far = bias_trend(there, 0.5).leaving, bias_trend(there, 0.5 * wider).leaving
    assert near is not None
    assert far is not None
    for sooner, later in ((near.earliest, far.earliest), (near.middle, far.middle), (near.latest, far.latest)):
        assert (sooner or np.inf) <= (later or np.inf)


@given(biases=BIASES)
def test_intervals_are_in_order_and_finite(biases: list[float]) -> None:
    spread = 2.0 * LEAST_SPREAD_DEGC
    trend = bias_trend([seen(40.0 * i, x, t=20.0 + spread * (i % 2)) for i, x in enumerate(biases)], 0.5)
    for slopes in (trend.per_year, trend.per_degc):
        assert slopes is not None
        for one in slopes:
            assert np.isfinite([one.low, one.value, one.high]).all()
            assert one.low <= one.value <= one.high


@given(biases=BIASES, sd=st.sampled_from([1e-12, 1e-6, 1e-3, 1.0]))
def test_any_ratio_of_noise_to_scatter_can_be_read(biases: list[float], sd: float) -> None:
    observations = [dataclasses.replace(seen(40.0 * i, x), sd=(sd, sd, sd)) for i, x in enumerate(biases)]
    trend = bias_trend(observations, 0.5)
    assert trend.per_year is not None
    assert np.isfinite([v for one in trend.per_year for v in (one.low, one.value, one.high)]).all()


@pytest.mark.long
def test_the_interval_of_a_slope_holds_as_often_as_stated() -> None:
    """Random walks without drift, temperatures beside them: 90 % of the axes within three deviations."""
    rng = np.random.default_rng(5)
    held = []
    for _ in range(60):
        days = np.concatenate([[0.0], np.cumsum(rng.uniform(30.0, 180.0, 5))])
        steps = np.sqrt(np.diff(days))[:, None] * rng.standard_normal((5, 3))
        walk = np.concatenate([np.zeros((1, 3)), 1e-3 * np.cumsum(steps, axis=0)])
        observations = [
            BiasObservation(day * DAY_S, (w[0], w[1], w[2]), (1e-5,) * 3, t)
            for day, w, t in zip(days.tolist(), walk.tolist(), rng.uniform(10.0, 45.0, 6).tolist(), strict=True)
        ]
        trend = bias_trend(observations, 0.5)
        assert trend.per_degc is not None
        held += [one.low <= 0.0 <= one.high for one in trend.per_degc]
    assert np.mean(held) == pytest.approx(0.9, abs=3.0 * np.sqrt(0.09 / len(held)))
