from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.flight.rest_temperatures import difference, logs_of
from mavcal.calib.flight.thermal import ThermalRequest, fit_rests
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Identity, ParameterTimeline, Sensor
from tests.unit.flight.made import Unit, log

ACCEL = ((8e-3, -5e-3, 12e-3), (150e-6, 0.0, 0.0))
GYRO = ((3e-4, -2e-4, 1.5e-4),)
DRIFTING = Unit((0.3, -0.2, 0.15), (0.01, -0.015, 0.008), ACCEL, GYRO)
STEADY = Unit()
QUADRATIC = ThermalRequest(2, 35.0, 10.0)


def errors(fit, truth):
    """Errors of the polynomial, in standard deviations."""
    degree = fit.model.polynomial.coefficients.shape[1]
    wanted = np.zeros((3, degree))
    wanted[:, : len(truth)] = np.array(truth).T
    sd = np.sqrt(np.diag(fit.covariance)[12:]).reshape(3, degree)
    return (fit.model.polynomial.coefficients - wanted) / sd


def fitted(recordings, sensor, instance=0, wish=QUADRATIC):
    return fit_rests(logs_of(recordings), sensor, instance, wish, relative=False)


def test_two_logs_in_two_poses_give_one_curve():
    logs = [
        log([DRIFTING], (22.0, 40.0), seed=1, before=120.0, after=40.0),
        log([DRIFTING], (50.0, 32.0), seed=2, before=120.0, after=40.0, roll=8.0, turn_on=(0.002, -0.001, 0.003)),
    ]
    accel, gyro = fitted(logs, Sensor.ACCEL), fitted(logs, Sensor.GYRO)
    assert accel.status == gyro.status == FitStatus.OK
    assert np.abs(errors(accel, ACCEL)).max() < 3.5
    assert np.abs(errors(gyro, GYRO)).max() < 3.5
    assert accel.quality["logs"] == gyro.quality["logs"] == 2
    assert gyro.model.offset == pytest.approx([0.012, -0.016, 0.011], abs=2e-4)  # turn-on bias of the last log
    assert "offset_x" in accel.undetermined


def test_a_rest_after_the_flight_counts_against_a_steady_neighbour():
    recording = log([DRIFTING, STEADY], (23.0, 53.0), seed=3)
    alone = fitted([recording], Sensor.ACCEL, wish=dataclasses.replace(QUADRATIC, reference="gravity"))
    against = fitted([recording], Sensor.ACCEL)
    assert np.max(against.quality["drift_sd"]) < 0.5 * np.max(alone.quality["drift_sd"])
    assert against.quality["reference"] == "difference"
    assert np.abs(errors(against, ACCEL)).max() < 3.5
    assert any("reference is accel 2" in w for w in against.warnings)


SHORT = {"before": 45.0, "flight": 155.0, "after": 0.0}


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO])
def test_the_flight_counts_where_the_rests_are_too_narrow(sensor):
    recording = log([DRIFTING, STEADY], (30.0, 52.0), seed=20, noise=0.003, **SHORT)
    misaligned = [
        dataclasses.replace(
            c, values=c.values @ np.array([[1.002, 0.01, 0.0], [0.0, 0.998, -0.008], [0.005, 0.0, 1.0]])
        )
        if c.instance == 0 and c.sensor == sensor
        else c
        for c in recording.channels
    ]
    fit = fitted([recording.with_channels(misaligned)], sensor)
    assert fit.status == FitStatus.PARTIAL
    assert {"offset_x", "offset_y", "offset_z"} <= set(fit.undetermined)
    assert fit.model.polynomial.t_max > 51.0
    assert np.abs(errors(fit, ACCEL if sensor == Sensor.ACCEL else GYRO)).max() < 3.5
    assert any("of flight counts as well" in w for w in fit.warnings)
    refused = fitted([recording], sensor, wish=dataclasses.replace(QUADRATIC, reference="gravity"))
    assert refused.status == FitStatus.REFUSED


def test_a_flight_beside_a_neighbour_that_cannot_be_judged_is_refused():
    recording = log([DRIFTING, STEADY], (30.0, 52.0), seed=21, noise=0.1, **SHORT)
    fit = fitted([recording], Sensor.ACCEL)
    assert fit.status == FitStatus.REFUSED
    assert any("may drift by itself" in w for w in fit.warnings)


def test_a_neighbour_that_drifts_itself_is_no_reference():
    both = log([DRIFTING, DRIFTING], (23.0, 53.0), seed=4)
    fit = fitted([both], Sensor.ACCEL)
    assert fit.quality["reference"] == "gravity"
    assert any("may drift by itself" in w for w in fit.warnings)
    forced = fitted([both], Sensor.ACCEL, wish=dataclasses.replace(QUADRATIC, reference="difference"))
    assert forced.status == FitStatus.REFUSED
    assert "no other accelerometer" in forced.message


def test_a_sensor_without_drift_is_said_to_have_none():
    fit = fitted([log([STEADY], (22.0, 45.0), seed=5)], Sensor.GYRO)
    assert np.abs(errors(fit, ())).max() < 3.5
    assert any("nothing to correct" in w for w in fit.warnings)


def test_a_narrow_span_is_refused_with_both_numbers():
    fit = fitted([log([DRIFTING], (30.0, 36.0), seed=6)], Sensor.GYRO)
    assert fit.status == FitStatus.REFUSED
    assert "moved by 6.0 degC (30.0 to 36.0" in fit.message
    assert "10 are needed" in fit.message
    assert fit.movements


def test_two_narrow_logs_far_apart_do_not_make_a_wide_one():
    logs = [log([DRIFTING], ends, seed=7, flight=0.0, after=0.0) for ends in ((10.0, 13.0), (40.0, 43.0))]
    fit = fitted(logs, Sensor.ACCEL)
    assert fit.status == FitStatus.REFUSED
    assert "moved by 6.0 degC (10.0 to 43.0" in fit.message


def test_a_vehicle_that_never_rested_is_refused():
    recording = log([DRIFTING], (20.0, 40.0), seed=8, before=0.0, after=0.0)
    fit = fitted([recording], Sensor.ACCEL)
    assert fit.status == FitStatus.REFUSED
    assert "never rested" in fit.message


def test_what_is_flown_does_not_matter():
    calm = log([DRIFTING], (22.0, 45.0), seed=9, vibration=0.0)
    wild = log([DRIFTING], (22.0, 45.0), seed=9, vibration=30.0)
    first, second = fitted([calm], Sensor.GYRO), fitted([wild], Sensor.GYRO)
    assert first.n_used == second.n_used
    assert np.abs(errors(second, GYRO)).max() < 3.5


def test_logs_of_other_vehicles_or_sensors_are_not_pooled():
    one = log([STEADY], (20.0, 40.0), seed=10)
    other = dataclasses.replace(one, identity=Identity("ardupilot", uid="b"))
    with pytest.raises(InvalidInputError, match="2 different vehicles"):
        logs_of([dataclasses.replace(one, identity=Identity("ardupilot", uid="a")), other])
    with pytest.raises(InvalidInputError, match="different autopilots"):
        logs_of([one, dataclasses.replace(one, identity=Identity("px4"))])
    ids = [dataclasses.replace(one, parameters=ParameterTimeline.constant({"INS_ACC_ID": n})) for n in (11, 12)]
    with pytest.raises(InvalidInputError, match="device id 11 in one log and 12"):
        logs_of(ids)


def test_no_thermometer_is_said():
    recording = log([STEADY], (20.0, 40.0), seed=11)
    blind = recording.with_channels(c for c in recording.channels if c.sensor != Sensor.TEMPERATURE)
    with pytest.raises(InvalidInputError, match="log it from the vehicle"):
        fitted([blind], Sensor.GYRO)


def test_the_difference_is_taken_at_the_times_of_the_first():
    recording = log([DRIFTING, STEADY], (20.0, 40.0), seed=12)
    a, b = recording.channel(Sensor.GYRO, 0), recording.channel(Sensor.GYRO, 1)
    late = b.take(slice(100, None, 2))
    found = difference(a, late)
    assert found is not None
    assert found.t[0] == pytest.approx(late.t[0])
    middle = found.between(10.0, 50.0).values.mean(axis=0)
    assert middle == pytest.approx((a.between(10.0, 50.0).values - b.between(10.0, 50.0).values).mean(axis=0), abs=1e-4)
    assert difference(a, dataclasses.replace(b, unit="counts")) is None
    assert difference(a, dataclasses.replace(b, t=b.t + 1e6)) is None


def test_the_methods_pool_logs_and_the_line_agrees():
    logs = [log([DRIFTING], (22.0, 45.0), seed=13), log([DRIFTING], (25.0, 48.0), seed=14, roll=5.0)]
    line = METHODS["thermal-linear"].run_pooled(logs, {"sensor": "gyro", "tref": 35.0})[0]
    curve = METHODS["thermal-poly"].run_pooled(logs, {"sensor": "gyro", "degree": 1})[0]
    assert line.model.polynomial.coefficients == pytest.approx(curve.model.polynomial.coefficients, rel=0.01)
    assert np.abs(errors(line, GYRO)).max() < 3.5
    with pytest.raises(InvalidInputError, match="takes one recording, not 2"):
        METHODS["gyro-rest"].run_pooled(logs)
    table = dataclasses.replace(logs[0], identity=Identity())
    with pytest.raises(InvalidInputError, match="logs and tables do not pool"):
        METHODS["thermal-poly"].run_pooled([logs[1], table])


@pytest.mark.long
@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO])
def test_the_sd_is_honest_over_many_logs(sensor):
    truth = ACCEL if sensor == Sensor.ACCEL else GYRO
    squares = []
    for seed in range(16):
        made = [log([DRIFTING], (22.0, 42.0), seed=100 + seed, rate=20.0)]
        made.append(log([DRIFTING], (48.0, 30.0), seed=200 + seed, rate=20.0, roll=6.0))
        squares.append(errors(fitted(made, sensor), truth) ** 2)
    # white noise: the sd allows for a slow wander that is not there (calib.stats.correlated): the safe side
    assert 0.2 < float(np.mean(squares)) < 1.2
