"""Plans at the borders of the composers' rules: what is absent, what is almost, and what is said then."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.compose.mag_motor import compensated, compose_motors, corrupt_compensation
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.compose.trim import adjust_trim, compose_level, force_when_level
from mavcal.calib.firmware.plan import Fingerprint, ParameterKind
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import ParameterTimeline, Sensor

from .test_mag_motor import motor_fit

LEVEL = {"AHRS_TRIM_X": 0.02, "AHRS_TRIM_Y": 0.01}


def new(plan):
    return {c.name: c.new for c in plan.changes}


def test_an_autopilot_that_nobody_knows_is_refused(make_fit):
    with pytest.raises(FirmwareError, match="cannot be written to the autopilot betaflight"):
        compose([make_fit(Sensor.GYRO)], {}, Fingerprint("betaflight", "", "", ()))


def test_a_sensor_without_parameters_is_left_out_and_said(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fits = [make_fit(Sensor.GYRO, offset=[0.01, 0, 0]), make_fit(Sensor.GYRO, 7, offset=[0.01, 0, 0])]
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint)
    assert "INS_GYROFFS_X" in new(plan)
    assert any("gyro 8 is left out: ArduPilot has parameters for 5 sensors" in text for text in plan.warnings)
    alone = compose(fits[1:], ardupilot_parameters, ardupilot_fingerprint)
    assert [text.split(";")[0] for text in alone.blockers] == ["ArduPilot has parameters for 5 sensors"]


@pytest.mark.parametrize(
    ("sensor", "boot", "warned"), [("gyro", 1, True), ("gyro", 0, False), ("gyro", None, True), ("accel", 1, False)]
)
def test_the_next_boot_is_warned_of_where_gyro_offsets_are_written(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, sensor, boot, warned
):
    known = {n: v for n, v in ardupilot_parameters.items() if n != "INS_GYR_CAL"}
    known |= {} if boot is None else {"INS_GYR_CAL": boot}
    fit = make_fit(Sensor(sensor), offset=[0.01, 0.02, 0.03])
    plan = compose([fit], known, ardupilot_fingerprint)
    assert new(plan)
    assert any("the next boot discards these gyro offsets" in text for text in plan.warnings) == warned


@pytest.mark.parametrize("mark", [True, False])
def test_accelerometers_are_marked_as_calibrated_where_that_is_wished(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, mark
):
    known = ardupilot_parameters | {"INS_USE2": 0}
    fit = make_fit(Sensor.ACCEL, offset=[0.1, 0.2, 0.3], matrix_sd=1e-4)
    plan = compose([fit], known, ardupilot_fingerprint, options=ComposeOptions(mark_calibrated=mark))
    assert [(a.command, a.params) for a in plan.after] == ([(241, (0, 0, 0, 0, 76, 0, 0))] if mark else [])
    both = compose([fit], ardupilot_parameters, ardupilot_fingerprint, options=ComposeOptions(mark_calibrated=mark))
    assert both.after == ()
    assert any(text.startswith("accelerometer 2 is in use but was never calibrated") for text in both.warnings)
    known = ardupilot_parameters | {"INS_ACC2OFFS_Y": 0.1}
    assert (
        bool(compose([fit], known, ardupilot_fingerprint, options=ComposeOptions(mark_calibrated=mark)).after) == mark
    )


def test_a_board_without_caltemp_gets_offsets_alone(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    known = {n: v for n, v in ardupilot_parameters.items() if not n.endswith("CALTEMP")}
    plan = compose([make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03])], known, ardupilot_fingerprint)
    assert set(new(plan)) == {f"INS_GYROFFS_{a}" for a in "XYZ"}
    assert plan.blockers == ()


@pytest.mark.parametrize(("temperature", "stored"), [(31.5, 31.5), (None, -300.0)])
def test_the_temperature_of_an_offset_is_written_with_it(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, temperature, stored
):
    known = ardupilot_parameters | {"INS_GYR1_CALTEMP": 20.0}
    plan = compose(
        [make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], temperature=temperature)], known, ardupilot_fingerprint
    )
    assert new(plan)["INS_GYR1_CALTEMP"] == stored
    assert any("INS_GYR1_CALTEMP is set to -300 (unknown)" in t for t in plan.warnings) == (temperature is None)


class TestTrim:
    def level(self, make_fit, roll, pitch, instance=0, **more):
        native = {"roll": roll, "pitch": pitch, "roll_sd": 2e-4, "pitch_sd": 3e-4}
        return make_fit(Sensor.ACCEL, instance, method="level", native=native, **more)

    def test_the_first_unit_s_level_counts_in_the_unit_of_the_autopilot(
        self, make_fit, ardupilot_parameters, px4_parameters
    ):
        fits = [self.level(make_fit, 0.09, 0.0, 1), self.level(make_fit, 0.03, -0.02)]
        for autopilot, known, per_rad, unit in (
            ("ardupilot", ardupilot_parameters, 1.0, "rad"),
            ("px4", px4_parameters, 180.0 / np.pi, "deg"),
        ):
            draft = Draft(known, ComposeOptions(), ParameterKind.INT32)
            assert compose_level(draft, autopilot, fits) is None
            roll, pitch = draft.changes
            assert (roll.new, pitch.new) == (pytest.approx(0.03 * per_rad), pytest.approx(-0.02 * per_rad))
            assert (roll.sd, pitch.sd) == (pytest.approx(2e-4 * per_rad), pytest.approx(3e-4 * per_rad))
            assert (roll.unit, roll.sensor) == (unit, None)
            assert roll.why == "level trim, roll: the attitude that was measured is level"

    def test_a_refused_level_counts_for_nothing(self, make_fit, ardupilot_parameters):
        draft = Draft(ardupilot_parameters, ComposeOptions(), ParameterKind.INT32)
        assert compose_level(draft, "ardupilot", [self.level(make_fit, 0.1, 0.0, status=FitStatus.REFUSED)]) is None
        assert compose_level(draft, "ardupilot", []) is None
        assert draft.changes == ()

    @pytest.mark.parametrize(("degrees", "planned"), [(9.99, True), (10.01, False)])
    def test_ten_degrees_are_the_most(self, make_fit, ardupilot_parameters, degrees, planned):
        draft = Draft(ardupilot_parameters, ComposeOptions(), ParameterKind.INT32)
        compose_level(draft, "ardupilot", [self.level(make_fit, 0.0, np.radians(-degrees))])
        assert bool(draft.changes) == planned
        assert bool(draft.plan(None).blockers) != planned

    def carried(self, make_fit, parameters, offset, **more):
        draft = Draft(parameters, ComposeOptions(**more), ParameterKind.INT32)
        fit = make_fit(Sensor.ACCEL, offset=offset, offset_sd=2e-3)
        for axis, value in zip("XYZ", offset, strict=True):
            draft.set_real(f"INS_ACCOFFS_{axis}", value, 5, "", about=Subject(Sensor.ACCEL, 0))
        adjust_trim(draft, "ardupilot", [fit])
        return draft

    def test_an_offset_turns_the_level_with_it(self, make_fit, ardupilot_parameters):
        draft = self.carried(make_fit, ardupilot_parameters | LEVEL, (0.0, 0.2, 0.0))
        force = force_when_level(0.02, 0.01) - [0.0, 0.2, 0.0]
        roll, pitch = draft.planned(["AHRS_TRIM_X", "AHRS_TRIM_Y"])
        assert roll.new == pytest.approx(np.arctan2(-force[1], -force[2]), rel=1e-6)
        assert pitch.new == pytest.approx(np.arctan2(force[0], np.hypot(force[1], force[2])), rel=1e-6)
        assert roll.sd == pytest.approx(2e-3 / 9.80665)

    def test_it_stays_where_that_is_not_wished_or_there_is_no_level(self, make_fit, ardupilot_parameters):
        known = ardupilot_parameters | LEVEL
        assert len(self.carried(make_fit, known, (0.0, 0.2, 0.0), adjust_level=False).changes) == 1
        never = self.carried(make_fit, ardupilot_parameters, (0.0, 0.2, 0.0))
        assert len(never.changes) == 1
        assert "the vehicle's level was never measured" in never.plan(None).warnings[0]
        for name in LEVEL:
            less = {n: v for n, v in known.items() if n != name}
            assert len(self.carried(make_fit, less, (0.0, 0.2, 0.0)).changes) == 1


class TestMotors:
    GAINS = dict.fromkeys(("COMPASS_MOT_X", "COMPASS_MOT_Y", "COMPASS_MOT_Z"), 0.0)

    @pytest.mark.parametrize(
        ("kind", "gain", "found"), [(2, 0.5, True), (2, 0.0, False), (0, 0.5, False), (None, 0.5, False)]
    )
    def test_a_compensation_needs_a_kind_and_a_gain(self, ardupilot_parameters, kind, gain, found):
        known = {n: v for n, v in ardupilot_parameters.items() if n != "COMPASS_MOTCT"}
        known |= self.GAINS | {"COMPASS_MOT_Z": gain} | ({} if kind is None else {"COMPASS_MOTCT": kind})
        assert compensated("ardupilot", known, 0) is found
        without = {n: v for n, v in known.items() if "_MOT_" not in n}
        assert compensated("ardupilot", without, 0) is False
        assert compensated("ardupilot", known, 9) is False
        px4 = {"CAL_MAG0_ZCOMP": gain} | ({} if kind is None else {"CAL_MAG_COMP_TYP": kind})
        assert compensated("px4", px4, 0) is found

    @pytest.mark.parametrize(
        ("autopilot", "known", "bad"),
        [
            ("ardupilot", {"COMPASS_MOTCT": 2, "COMPASS_MOT_Z": float("nan")}, "COMPASS_MOT_Z = nan"),
            ("ardupilot", {"COMPASS_OFS_Y": float("inf"), "COMPASS_OFS_X": 5.0}, "COMPASS_OFS_Y = inf"),
            ("px4", {"CAL_MAG_COMP_TYP": 1, "CAL_MAG0_XCOMP": 10.0}, ""),
            ("px4", {"CAL_MAG_COMP_TYP": 1, "CAL_MAG0_XCOMP": -10.1}, "CAL_MAG0_XCOMP = -10.1"),
            ("px4", {"CAL_MAG_COMP_TYP": 2, "CAL_MAG0_XCOMP": 1000.0}, ""),
            ("px4", {"CAL_MAG_COMP_TYP": 2, "CAL_MAG0_XCOMP": 1000.5}, "CAL_MAG0_XCOMP = 1000.5"),
            ("px4", {"CAL_MAG_COMP_TYP": 3, "CAL_MAG0_XCOMP": 1000.5}, "CAL_MAG0_XCOMP = 1000.5"),
            ("px4", {"CAL_MAG_COMP_TYP": 9, "CAL_MAG0_XCOMP": 1e9}, ""),
            ("px4", {"CAL_MAG_COMP_TYP": 0, "CAL_MAG0_XCOMP": 1e9}, ""),
            ("px4", {"CAL_MAG0_XCOMP": 1e9}, ""),
            ("px4", {"CAL_MAG_COMP_TYP": float("nan"), "CAL_MAG0_XCOMP": 0.5}, "CAL_MAG0_XCOMP = 0.5"),
            ("px4", {"CAL_MAG0_XOFF": 1e9}, ""),
            (None, {"CAL_MAG0_XOFF": float("nan")}, ""),
        ],
    )
    def test_what_is_corrupt_is_named(self, autopilot, known, bad):
        told = corrupt_compensation(autopilot, ParameterTimeline.constant(known), 0)
        assert told.startswith(f"corrupt parameters in force for compass 1: {bad}. What") == bool(bad)
        assert bool(told) == bool(bad)

    def test_the_kind_that_helps_most_is_written_and_the_rest_is_told(self, ardupilot_parameters):
        known = ardupilot_parameters | self.GAINS | {"COMPASS_MOTCT": 0}
        known |= {n.replace("MOT_", "MOT2_"): 0.0 for n in self.GAINS}
        draft = Draft(known, ComposeOptions(), ParameterKind.INT32)
        compose_motors(draft, "ardupilot", [motor_fit(), motor_fit(1, proposed=False)])
        planned = {c.name: c for c in draft.changes}
        assert planned["COMPASS_MOTCT"].why == "compensate against current"
        assert planned["COMPASS_MOTCT"].new == 2
        assert {c.unit for n, c in planned.items() if n != "COMPASS_MOTCT"} == {"mGauss/A"}
        assert not any("MOT2" in name for name in planned)
        assert draft.losses == ()
        other = Draft(known, ComposeOptions(), ParameterKind.INT32)
        compose_motors(
            other, "ardupilot", [motor_fit(), motor_fit(1, drive="throttle", current_rms=1.0, throttle_rms=0.9)]
        )
        (loss,) = other.losses
        assert (loss.instance, loss.unit, loss.cost) == (1, "uT", pytest.approx(0.1))
        none = Draft(known | {"COMPASS_MOTCT": 2, "COMPASS_MOT_X": 4.0}, ComposeOptions(), ParameterKind.INT32)
        compose_motors(none, "ardupilot", [motor_fit(proposed=False)])
        taken = {c.name: c for c in none.changes}
        assert {name: c.new for name, c in taken.items()} == {"COMPASS_MOT_X": 0.0, "COMPASS_MOTCT": 0}
        assert taken["COMPASS_MOT_X"].why == "no motor compensation helps mag 1 on unseen data"
        assert taken["COMPASS_MOTCT"].why == "no compass needs compensation"

    def test_a_fit_in_another_unit_is_refused(self, ardupilot_parameters):
        draft = Draft(ardupilot_parameters | self.GAINS | {"COMPASS_MOTCT": 0}, ComposeOptions(), ParameterKind.INT32)
        fit = dataclasses.replace(motor_fit(), unit="1")
        assert isinstance(fit, FitResult)
        compose_motors(draft, "ardupilot", [fit])
        assert draft.changes == ()
        assert draft.plan(None).blockers == ("mag 1: the fit is in 1, parameters are in gauss",)
        compose_motors(draft, "ardupilot", [])
        assert draft.changes == ()


@pytest.mark.parametrize("autocal", [None, 0, 1])
def test_px4_s_own_writers_are_silenced_for_the_session(px4_parameters, px4_fingerprint, make_fit, autocal):
    known = {n: v for n, v in px4_parameters.items() if n not in ("SENS_IMU_AUTOCAL", "IMU_GYRO_CAL_EN")}
    known |= {} if autocal is None else {"SENS_IMU_AUTOCAL": autocal, "IMU_GYRO_CAL_EN": autocal}
    plan = compose([make_fit(Sensor.GYRO, offset=[0.02, 0.03, 0.04])], known, px4_fingerprint)
    assert [(c.name, c.new) for c in plan.changes if c.session] == ([("SENS_IMU_AUTOCAL", 0)] if autocal else [])
    assert any("IMU_GYRO_CAL_EN" in text for text in plan.warnings) == bool(autocal)


@pytest.mark.parametrize(("sensor", "unit", "size"), [(Sensor.ACCEL, "m/s2", 0.009)])
def test_an_offset_that_px4_cannot_take_costs_its_length(px4_parameters, px4_fingerprint, make_fit, sensor, unit, size):
    fit = make_fit(sensor, offset=[0.6 * size, 0.0, 0.8 * size], offset_sd=1e-5)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    (loss,) = [loss for loss in plan.losses if loss.what == "offset"]
    assert (loss.cost, loss.unit) == (pytest.approx(size), unit)


@pytest.mark.parametrize("learn", [None, 0, 3])
def test_learning_of_compasses_is_switched_off_where_it_is_on(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, learn
):
    known = {n: v for n, v in ardupilot_parameters.items() if n != "COMPASS_LEARN"}
    known |= {} if learn is None else {"COMPASS_LEARN": learn}
    fit = make_fit(Sensor.MAG, offset=[13.0, -22.0, 31.0], matrix_sd=1e-3)
    plan = compose([fit], known, ardupilot_fingerprint)
    assert plan.changes
    assert plan.blockers == ()
    assert [c.new for c in plan.changes if c.name == "COMPASS_LEARN"] == ([0] if learn else [])


def test_a_level_that_px4_holds_agrees_in_its_degrees(px4_parameters, make_fit):
    held = {"SENS_BOARD_X_OFF": 2.0, "SENS_BOARD_Y_OFF": -1.0}
    native = {"roll": 1e-5, "pitch": -1e-5, "roll_sd": 2e-4, "pitch_sd": 3e-4}  # of what is turned already
    draft = Draft(px4_parameters | held, ComposeOptions(), ParameterKind.INT32)
    found = compose_level(draft, "px4", [make_fit(Sensor.ACCEL, method="level", native=native)])
    assert found is not None
    assert found.deviation < 0.2
    assert draft.changes == ()
