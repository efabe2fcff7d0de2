"""A compass calibrated from a flight: what is found, how far it may be trusted, what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.flight import fit_flight
from mavcal.calib.mag.flight_fit import correlation_time
from mavcal.calib.mag.flight_input import end_of_flight
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.unit.mag.flights import FIELD, Truth, fly

SOFT = np.array([[1.04, 0.02, -0.01], [0.02, 0.97, 0.015], [-0.01, 0.015, 1.02]])


def rng(seed=11):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def plain():
    return fly(Truth(), rng())


@pytest.fixture(scope="module")
def plain_fit(plain):
    return fit_flight(plain.mag, plain.turning, field=FIELD, soft_iron="held")


def within(fit, offset, sds=4.0):
    return (np.abs(fit.model.offset - offset) < sds * fit.sd[:3]).all()


def test_the_offset_is_found_though_the_logs_heading_is_wrong_by_more_than_ten_degrees(plain, plain_fit):
    assert plain_fit.status == FitStatus.OK
    assert within(plain_fit, Truth().offset)
    assert plain_fit.sd[:3].max() < 0.3
    # who trusts the log's attitude is off by several of our sds
    w, x, y, z = plain.turning.attitude.values.T
    believed = Rotation.from_quat(np.column_stack([x, y, z, w])).inv().apply(FIELD.north_east_down)
    naive = (plain.mag.values - believed).mean(axis=0)
    assert np.linalg.norm(naive - Truth().offset) > 5.0 * np.linalg.norm(plain_fit.model.offset - Truth().offset)


def test_the_gyroscope_alone_finds_the_same(plain, plain_fit):
    fit = fit_flight(plain.mag, Turning(plain.turning.gyro, None), field=FIELD, soft_iron="held")
    assert within(fit, Truth().offset)
    assert fit.native["from"] == ["gyro"]
    assert np.linalg.norm(fit.model.offset - plain_fit.model.offset) < 0.3


def test_the_gyroscopes_offset_is_found_beside(plain_fit):
    assert np.allclose(plain_fit.native["gyro_bias"], Truth().gyro_bias, atol=5e-4)


def test_a_perfect_attitude_gives_what_plain_least_squares_give():
    """The second route: with an attitude that is right, offset = mean of what the field leaves."""
    made = fly(Truth(heading_error=0.0), rng(3))
    w, x, y, z = made.turning.attitude.values.T
    # the log's tilt errors (0.02 rad) remain: average over whole circles
    body = Rotation.from_quat(np.column_stack([x, y, z, w])).inv().apply(FIELD.north_east_down)
    fit = fit_flight(made.mag, made.turning, field=FIELD, soft_iron="held")
    assert np.abs(fit.model.offset - (made.mag.values - body).mean(axis=0)).max() < 1.0


@pytest.mark.long
def test_soft_iron_that_the_flight_shows_is_found():
    made = fly(Truth(matrix=SOFT, tilt=np.radians(40.0)), rng(5))
    fit = fit_flight(made.mag, made.turning, field=FIELD)
    error = np.abs(fit.model.matrix - np.linalg.inv(SOFT))
    told = ~np.isnan(fit.sd[3:12])
    assert told.sum() >= 4
    assert (error.ravel()[told] < 4.0 * fit.sd[3:12][told]).all()
    assert set(fit.movements) == set(fit.undetermined)


def test_a_compass_mounted_otherwise_gives_the_turned_model(plain, plain_fit):
    turn = Rotation.from_euler("ZYX", [90.0, 0.0, 180.0], degrees=True).as_matrix()  # body from sensor
    mag = dataclasses.replace(plain.mag, values=plain.mag.values @ turn)
    fit = fit_flight(mag, plain.turning, field=FIELD, soft_iron="held", body_from_sensor=turn)
    assert np.allclose(fit.model.offset, turn.T @ plain_fit.model.offset, atol=1e-6)


def test_a_shift_of_all_samples_shifts_the_offset(plain, plain_fit):
    mag = dataclasses.replace(plain.mag, values=plain.mag.values + np.array([20.0, -30.0, 10.0]))
    fit = fit_flight(mag, plain.turning, field=FIELD, soft_iron="held")
    assert np.allclose(fit.model.offset - plain_fit.model.offset, [20.0, -30.0, 10.0], atol=1e-4)


def test_spikes_and_holes_do_not_move_it(plain):
    values = plain.mag.values.copy()
    values[::37] += 300.0
    values[5::101] = np.nan
    fit = fit_flight(dataclasses.replace(plain.mag, values=values), plain.turning, field=FIELD, soft_iron="held")
    assert within(fit, Truth().offset)
    assert fit.quality["n_outliers"] >= len(values[::37]) - 1


@pytest.mark.long
def test_a_flight_straight_ahead_does_not_determine_the_offset_beside_an_unknown_field():
    made = fly(Truth(turns=0.0, tilt=np.radians(2.5), wander=0.01, noise=5.0), rng(7))
    fit = fit_flight(made.mag, Turning(made.turning.gyro, None), soft_iron="auto")
    assert fit.status != FitStatus.OK
    assert "offset_x" in fit.undetermined
    assert "circle" in fit.movements["offset_x"]


def test_what_the_flight_leaves_open_is_named_with_the_movement():
    made = fly(Truth(tilt=np.radians(3.0)), rng(9))
    fit = fit_flight(made.mag, made.turning, field=FIELD)
    assert fit.status == FitStatus.PARTIAL
    assert "matrix_zz" in fit.undetermined
    assert fit.covariance[11, 11] == 0.0
    assert fit.native["directions"][0]["sd"] < 0.01


def still(plain):
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(plain.turning.attitude), 1))
    return Turning(None, dataclasses.replace(plain.turning.attitude, values=level))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda m, t: (m.take(slice(0, 20)), t), "samples"),
        (lambda m, t: (dataclasses.replace(m, values=np.full_like(m.values, 7.0)), t), "constant"),
        (lambda m, t: (dataclasses.replace(m, values=np.full_like(m.values, np.nan)), t), "samples"),
        (lambda m, t: (m, Turning(None, None)), "neither"),
        (lambda m, t: (m, Turning(dataclasses.replace(t.gyro, values=t.gyro.values * 57.3 + 40.0), None)), "unit"),
        (lambda m, t: (dataclasses.replace(m, values=rng().normal(size=m.values.shape) * 40.0), t), "cause"),
    ],
)
def test_what_cannot_be_fitted_is_refused_with_the_reason(plain, change, word):
    mag, turning = change(plain.mag, plain.turning)
    fit = fit_flight(mag, turning, field=FIELD, soft_iron="held")
    assert fit.status == FitStatus.REFUSED
    assert word in fit.message


def test_a_vehicle_that_never_turns_is_refused(plain):
    fit = fit_flight(plain.mag, still(plain), field=FIELD, soft_iron="held")
    assert fit.status == FitStatus.REFUSED
    assert "never turned" in fit.message


def test_time_that_goes_back_and_another_unit_are_errors(plain):
    back = dataclasses.replace(plain.mag, t=plain.mag.t[::-1])
    with pytest.raises(InvalidInputError, match="goes back"):
        fit_flight(back, plain.turning, field=FIELD)
    degrees = Turning(dataclasses.replace(plain.turning.gyro, unit="deg/s"), None)
    with pytest.raises(InvalidInputError, match="rad/s"):
        fit_flight(plain.mag, degrees, field=FIELD)


def test_residuals_of_one_time_count_as_one():
    white = rng().normal(size=(4000, 3))
    slow = np.repeat(rng().normal(size=(200, 3)), 20, axis=0)
    assert correlation_time(white) < 1.2
    assert 10.0 < correlation_time(slow) < 30.0


def test_a_crash_ends_the_flight():
    t = np.arange(0.0, 60.0, 0.1)
    accel = np.tile([0.0, 0.0, -9.8], (len(t), 1))
    accel[500] = (0.0, 0.0, -90.0)
    tipped = np.where((t > 49.5)[:, None], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    f = Channel(Sensor.ACCEL, 0, t, accel, "m/s2", Stage.RAW, "t")
    q = Channel(Sensor.ATTITUDE, 0, t, tipped, "1", Stage.RAW, "t")
    assert 45.0 < end_of_flight(60.0, f, q) < 50.0
    level = dataclasses.replace(q, values=np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)))
    assert end_of_flight(60.0, f, level) == 60.0  # a hard landing is none


@pytest.mark.sampled
@pytest.mark.parametrize("compensated", [False, True])
def test_a_compensation_is_advised_only_where_none_is_in_force(compensated):
    made = fly(Truth(motor=np.array([0.3, -0.2, 0.4])), rng(21))
    fit = fit_flight(made.mag, made.turning, field=FIELD, drive=made.drives[0], compensated=compensated)
    (warning,) = [text for text in fit.warnings if "the motors add up to" in text]
    assert ("mag-motor" in warning) is not compensated
