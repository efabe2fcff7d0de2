"""What the first second of a warm-up says of its end."""

from __future__ import annotations

from mavcal.calib.firmware.compose.early_warnings import foreseen, unknown_sensors
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.triad import ThermalPolynomial

COPTER = Identity("ardupilot", 2, (4, 7, 0), "0123", 1, 1)
PLANE = Identity("px4", 1, (1, 16, 0), "0123", 1, 1)
CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-3, 6e-5, 1e-7]] * 3)


def test_an_unknown_caltemp_is_foreseen_in_the_words_of_the_plan(ardupilot_parameters, make_fit):
    told = foreseen(COPTER, ardupilot_parameters, ComposeOptions())
    fit = make_fit(Sensor.ACCEL, polynomial=CURVE, polynomial_sd=1e-5, undetermined=tuple(f"offset_{a}" for a in "xyz"))
    gyro = make_fit(Sensor.GYRO, polynomial=CURVE, polynomial_sd=1e-5)
    plan = compose([fit, gyro], ardupilot_parameters, fingerprint(COPTER, ardupilot_parameters))
    (loss,) = plan.losses
    assert loss.text in told
    assert "INS_ACC1_CALTEMP does not say" in loss.text
    assert not any("gyro" in text for text in told)


def test_nothing_is_foreseen_where_everything_can_be_written(ardupilot_parameters):
    known = {name: 25.0 for name in ardupilot_parameters if name.endswith("_CALTEMP")}
    assert foreseen(COPTER, ardupilot_parameters | known, ComposeOptions()) == ()


def test_only_the_sensors_that_are_planned_count(ardupilot_parameters):
    options = ComposeOptions(only=((Sensor.GYRO, 0),))
    assert foreseen(COPTER, ardupilot_parameters, options) == ()


def test_a_board_without_the_compensation_is_foreseen(ardupilot_parameters):
    assert not any("TCAL1_ENABLE" in text for text in foreseen(COPTER, ardupilot_parameters, ComposeOptions()))
    del ardupilot_parameters["INS_TCAL1_ENABLE"]
    assert any("INS_TCAL1_ENABLE" in text for text in foreseen(COPTER, ardupilot_parameters, ComposeOptions()))


def test_a_fourth_unit_does_not_stream(ardupilot_parameters):
    told = foreseen(COPTER, ardupilot_parameters | {"INS4_GYR_ID": 77}, ComposeOptions())
    (text,) = (text for text in told if "gyro 4" in text)
    assert "not stream" in text
    assert not any("gyro 4" in text for text in foreseen(COPTER, ardupilot_parameters, ComposeOptions()))


def test_px4_does_not_store_the_temperature_unless_it_is_given(px4_parameters):
    parameters = px4_parameters | {"CAL_ACC0_XOFF": 0.2, "TC_A_ENABLE": 1, "TC_G_ENABLE": 1, "IMU_GYRO_CAL_EN": 0}
    (text,) = foreseen(PLANE, parameters, ComposeOptions())
    assert "does not store at which temperature" in text
    assert "accel_temperature (--accel-temperature)" in text
    assert foreseen(PLANE, parameters, ComposeOptions(accel_temperature={0: 25.0})) == ()


def test_a_sensor_that_the_vehicle_does_not_have_is_named_with_those_it_has(px4_parameters):
    options = ComposeOptions(only=((Sensor.GYRO, 3),))
    told = unknown_sensors(PLANE, px4_parameters, options)
    assert told == "there is no gyro3 to plan for; there are: accel0, gyro0, mag0"
    assert unknown_sensors(PLANE, px4_parameters, ComposeOptions()) == ""
