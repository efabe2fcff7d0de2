"""What the recorded flights say, against what was injected into them."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.flight.item import FlightVerdict
from mavcal.calib.flight.report import flight_report
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.worthwhile import LoggedTrip, advice

pytestmark = pytest.mark.shared

TRUTH = {
    "accel": np.array([[8000.0, 150.0, 0.0], [-5000.0, 0.0, 0.0], [12000.0, 0.0, 0.0]]) * 1e-6,
    "gyro": np.array([[300.0, 0.0, 0.0], [-200.0, 0.0, 0.0], [150.0, 0.0, 0.0]]) * 1e-6,
}


@functools.cache
def flown(path):
    return logs.read(path)


def report(path):
    found = flight_report(flown(path))
    assert found is not None
    return found, {(item.name, item.subject): item for item in found.items}


def steps(path):
    found, _ = report(path)
    return advice(LoggedTrip(flown(path), found.rests, found.ground))


@pytest.mark.parametrize("degree", [2, 3])
def test_the_polynomial_of_the_first_unit_and_none_of_the_second(shared_data, degree):
    recording = flown(shared_data / "sitl_flights" / "vib_motor_temp.bin")
    for fit in METHODS["thermal-poly"].run(recording, {"degree": degree}):
        drifts = fit.instance == 0
        truth = (TRUTH[fit.sensor.value] if drifts else np.zeros((3, 3)))[:, :degree]
        found = fit.model.polynomial.coefficients
        sd = np.sqrt(np.diag(fit.covariance)[12:]).reshape(3, degree)
        assert fit.status == FitStatus.OK
        assert not fit.relative
        assert np.abs((found - truth) / sd).max() < 3.0
        assert any("nothing to correct" in w for w in fit.warnings) != drifts
        if drifts:
            assert found[:, 0] == pytest.approx(truth[:, 0], rel=0.01)
            assert fit.model.polynomial.t_max - fit.model.polynomial.t_min > 30.0
            if fit.sensor == "accel":
                assert found[0, 1] == pytest.approx(150e-6, rel=0.1)
                assert fit.quality["reference"] == "difference"


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_the_flight_itself_gives_the_polynomial_where_little_rest_was_logged(shared_data, sensor):
    cut = flown(shared_data / "sitl_flights" / "vib_motor_temp.bin").between(36.0, 130.0)
    first, second = METHODS["thermal-poly"].run(cut, {"degree": 2, "sensor": sensor})
    found, truth = first.model.polynomial.coefficients, TRUTH[sensor][:, :2]
    sd = np.sqrt(np.diag(first.covariance)[12:]).reshape(3, 2)
    assert np.abs((found - truth) / sd).max() < 3.0
    assert found[:, 0] == pytest.approx(truth[:, 0], rel=0.1)
    assert second.status == FitStatus.REFUSED
    assert any("gyroscope 1 may drift" in w or "accelerometer 1 may drift" in w for w in second.warnings)


def test_a_flight_without_warming_is_refused_with_its_span(shared_data):
    fits = METHODS["thermal-poly"].run(flown(shared_data / "sitl_flights" / "null.bin"))
    assert {fit.status for fit in fits} == {FitStatus.REFUSED}
    assert all("10 are needed" in fit.message for fit in fits)


def test_flights_of_one_vehicle_are_pooled_and_of_two_are_not(shared_data):
    folder = shared_data / "sitl_flights"
    whole = flown(folder / "vib_motor_temp.bin")
    parts = [whole.between(0.0, 30.0), whole.between(30.0, 200.0)]
    gyro = METHODS["thermal-poly"].run_pooled(parts, {"sensor": "gyro", "instance": 0, "degree": 1})[0]
    assert gyro.quality["logs"] == 2
    sd = np.sqrt(np.diag(gyro.covariance)[12:])
    assert np.abs((gyro.model.polynomial.coefficients[:, 0] - TRUTH["gyro"][:, 0]) / sd).max() < 3.0
    with pytest.raises(InvalidInputError, match="2 different vehicles"):
        METHODS["thermal-poly"].run_pooled([whole, flown(folder / "mix.bin")])


def test_the_bias_of_the_first_unit_is_found_beside_the_second(shared_data):
    found, items = report(shared_data / "sitl_flights" / "bias.bin")
    assert found.verdict == FlightVerdict.WARN
    apart = items["accel_consistency", "accel 1, 2"]
    assert apart.numbers["difference"] == pytest.approx([0.3, -0.2, 0.15], abs=5e-4)
    assert "accel 1 is the one that is off" in apart.text
    assert items["gyro_bias_at_rest", "gyro 1"].numbers["bias"] == pytest.approx([0.01, -0.015, 0.008], abs=5e-5)
    assert "gyro 1 is the one that is off" in items["gyro_consistency", "gyro 1, 2"].text
    assert items["level", "accel 1"].verdict == FlightVerdict.WARN
    assert {items[n, f"{s} 2"].verdict for n, s in (("gravity_at_rest", "accel"), ("gyro_bias_at_rest", "gyro"))} == {
        FlightVerdict.PASS
    }


def test_nothing_is_found_where_nothing_was_injected(shared_data):
    found, items = report(shared_data / "sitl_flights" / "null.bin")
    assert {item.verdict for item in found.items} <= {FlightVerdict.PASS, FlightVerdict.NOT_TESTABLE}
    assert items["gravity_at_rest", "accel 1"].numbers["lengths"][0] == pytest.approx(9.8175, abs=5e-4)
    scale = items["accel_scale", "accel 1, 2"]
    assert scale.numbers["scale"] == pytest.approx([1.0, 1.0, 1.0], abs=1e-3)
    worthwhile = {step.method for step in steps(shared_data / "sitl_flights" / "null.bin") if step.worthwhile}
    assert {"mag-flight", "mag-motor", "gyro-rest"} <= worthwhile
    assert not {"thermal-poly", "accel-multi", "mag-ellipsoid"} & worthwhile


def test_the_vibration_of_both_units(shared_data):
    _, items = report(shared_data / "sitl_flights" / "vib_motor_temp.bin")
    for unit in (1, 2):
        item = items["vibration", f"accel {unit}"]
        assert item.numbers["tones"][0]["hz"] == pytest.approx(87.0, abs=1.0)
        assert item.numbers["rms"] == pytest.approx([4.0 / np.sqrt(2.0)] * 3, rel=0.1)


def test_the_real_vehicle_with_three_units(shared_data):
    found, items = report(shared_data / "df_log171_triple_imu_mag" / "log171.bin")
    assert [rest.end < 73.0 for rest in found.rests] == [True] * len(found.rests)
    assert items["gravity_at_rest", "accel 3"].value > items["gravity_at_rest", "accel 1"].value
    assert items["vibration", "accel 1"].verdict == FlightVerdict.NOT_TESTABLE  # low-passed


def test_a_log_without_sensors_is_worth_nothing(shared_data):
    examples = shared_data / "df_loganalyzer_examples"
    found, _ = report(examples / "mechanical_fail.log")
    assert found.items == ()
    assert not any(step.worthwhile for step in steps(examples / "mechanical_fail.log"))
    motor = {step.method: step.reason for step in steps(examples / "nan.log")}["mag-motor"]
    assert "COMPASS_MOT_X" in motor
    assert "not a number" in motor
