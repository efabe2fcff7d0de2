"""The limits of the check of a sensor, summed up by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.plan import Change, Loss, ParameterKind, SensorVerdict, WritePlan
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import force_of
from mavcal.calib.firmware.proof.sensor_check import sensor_checks
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

GYRO, ACCEL, SECOND = Subject(Sensor.GYRO, 0), Subject(Sensor.ACCEL, 0), Subject(Sensor.ACCEL, 1)
NAMES = {GYRO: "INS_GYROFFS_X", ACCEL: "INS_ACCOFFS_X", SECOND: "INS_ACC2OFFS_X"}
G = 9.80665
FIXED = 2 * 7.292115e-5 + 1.5e-5 * 120.0
"""rad/s: the Earth in two attitudes, and two minutes of a gyroscope's walk."""
SPREAD = np.diag([4e-8, 1e-8, 9e-8])
CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[1e-4, 0.0], [0.0, 1e-6], [0.0, 0.0]])


def reading(mean, *, t=5.0, temperature=32.0, covariance=SPREAD):
    return StillMean(t, np.array(mean, dtype=np.float64), covariance, temperature, rest=0)


def checks(parameters, fits, readings, *, losses=(), drift=None, raw=(), changed=None):
    """The checks of sensors with `fits` that read `readings`, both by subject."""
    changes = tuple(
        Change(NAMES[about], 0.0, 0.5, ParameterKind.REAL32, "", sensor=about.sensor, instance=about.instance)
        for about in (fits if changed is None else changed)
    )
    plan = WritePlan(None, "", changes, losses=tuple(losses))
    pairs = {about: Pair(about, fit, drift) for about, fit in fits.items()}
    force = force_of("ardupilot", parameters, changes)
    return sensor_checks(plan, pairs, StreamEvidence(readings, {}, frozenset(raw)), force)


def gyro_check(parameters, fit, *readings, **more):
    (check,) = checks(parameters, {GYRO: fit}, {GYRO: readings}, **more)
    return check


@pytest.fixture
def gyro_fit(make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.5, 0.0, 0.0])
    covariance = fit.covariance.copy()
    covariance[:3, :3] = np.diag([1e-8, 2e-8, 4e-8])
    return dataclasses.replace(fit, covariance=covariance)


class TestGyro:
    def test_the_limit_is_the_sum_of_what_may_be(self, ardupilot_parameters, gyro_fit):
        check = gyro_check(ardupilot_parameters, gyro_fit, reading([0.001, -0.003, 0.0025], temperature=33.5))
        sd = np.sqrt(1e-8 + 2e-8 + 5e-5**2)
        assert check.value == pytest.approx(0.003)
        assert check.sd == pytest.approx(sd)
        assert check.limit == pytest.approx(FIXED + 5.0 * sd + 2.0 * 5e-4 * 1.5)
        assert (check.id, check.unit, check.verdict) == ("gyro_zero", "rad/s", SensorVerdict.RIGHT)
        limit = np.degrees(check.limit)
        assert check.text == f"gyro 1 reads -0.172 deg/s about y at rest; the limit is {limit:.3f} deg/s"

    def test_the_fit_is_turned_as_the_board_is(self, ardupilot_parameters, gyro_fit):
        turned = ardupilot_parameters | {"AHRS_ORIENTATION": 2}  # yaw 90: body y is the sensor's x
        check = gyro_check(turned, gyro_fit, reading([0.001, -0.008, 0.0025]))
        sd = np.sqrt(1e-8 + 1e-8 + 5e-5**2)
        assert check.limit == pytest.approx(FIXED + 5.0 * sd)
        assert check.verdict == SensorVerdict.WRONG
        assert check.text.endswith(
            f"; at most {np.degrees(check.limit):.3f} deg/s is explained by noise, drift and the fit"
        )
        assert check.text.startswith("gyro 1 reads -0.458 deg/s about y at rest")

    @pytest.mark.parametrize(("reference", "now"), [(None, 32.0), (32.0, None), (32.0, 60.0)])
    def test_drift_that_is_not_known_is_a_quarter_degree_at_most(self, ardupilot_parameters, gyro_fit, reference, now):
        fit = dataclasses.replace(gyro_fit, temperature=reference)
        check = gyro_check(ardupilot_parameters, fit, reading([0.0, 0.0, 0.0015], temperature=now))
        sd = np.sqrt(9e-8 + 4e-8 + 5e-5**2)
        assert check.limit == pytest.approx(FIXED + 5.0 * sd + np.radians(0.25))

    def test_a_measured_drift_leaves_what_a_thermal_job_aims_at(self, ardupilot_parameters, gyro_fit, make_fit):
        drift = make_fit(Sensor.GYRO, polynomial=CURVE, polynomial_sd=1e-5)
        check = gyro_check(ardupilot_parameters, gyro_fit, reading([0.0, 0.0, 0.001], temperature=50.0), drift=drift)
        assert check.limit == pytest.approx(FIXED + 5.0 * np.sqrt(13e-8 + 5e-5**2) + np.radians(0.05))

    def test_a_drift_alone_is_held_at_the_temperature_of_the_reading(self, ardupilot_parameters, make_fit):
        drift = make_fit(Sensor.GYRO, polynomial=CURVE, polynomial_sd=1e-5, offset_sd=0.0)
        now = reading([0.0, 0.001, 0.0], temperature=35.0, covariance=1e-8 * np.eye(3))
        changes = (Change("INS_GYROFFS_X", 0.0, 0.5, ParameterKind.REAL32, "", sensor=Sensor.GYRO),)
        (check,) = sensor_checks(
            WritePlan(None, "", changes),
            {GYRO: Pair(GYRO, None, drift)},
            StreamEvidence({GYRO: (now,)}, {}, frozenset()),
            force_of("ardupilot", ardupilot_parameters, changes),
        )
        sd = np.sqrt(1e-8 + (1e-5 * 10) ** 2 + (1e-6 * 100) ** 2 + 5e-5**2)
        assert check.sd == pytest.approx(sd)
        assert check.limit == pytest.approx(FIXED + 5 * sd + np.radians(0.05))

    def test_what_the_firmware_cannot_hold_of_this_sensor_is_allowed(self, ardupilot_parameters, gyro_fit):
        def loss(sensor, instance, what, unit):
            return Loss(sensor, instance, what, 0.01, unit, "")

        mine = loss(Sensor.GYRO, 0, "offset", "rad/s")
        others = [loss(Sensor.ACCEL, 0, "offset", "m/s2"), loss(Sensor.GYRO, 1, "offset", "rad/s")]
        others += [loss(Sensor.GYRO, 0, "matrix", "rad/s at 1 rad/s"), loss(Sensor.GYRO, 0, "mounting", "rad/s")]
        plain, less, more = (
            gyro_check(ardupilot_parameters, gyro_fit, reading([0, 0, 0.001]), losses=losses).limit
            for losses in ((), others, [*others, mine, mine])
        )
        assert less == plain
        assert more == pytest.approx(plain + 0.02)

    def test_an_open_axis_is_not_judged(self, ardupilot_parameters, gyro_fit):
        fit = dataclasses.replace(gyro_fit, undetermined=("offset_y",))
        check = gyro_check(ardupilot_parameters, fit, reading([0.001, 0.9, 0.0005]))
        assert check.value == pytest.approx(0.001)
        none = dataclasses.replace(gyro_fit, undetermined=("offset_x", "offset_y", "offset_z"))
        blind = gyro_check(ardupilot_parameters, none, reading([0.001, 0.9, 0.0005]))
        assert (blind.value, blind.limit, blind.sd, blind.unit) == (None, None, None, "rad/s")
        assert blind.verdict == SensorVerdict.NOT_OBSERVABLE
        assert blind.text == "gyro 1 was not at rest in a pose and at a temperature that can be judged"

    def test_the_best_reading_of_one_temperature_counts_and_the_worst_temperature(self, ardupilot_parameters, gyro_fit):
        bad, good = [0.02, 0, 0], [0.0001, 0, 0]
        near = gyro_check(ardupilot_parameters, gyro_fit, reading(bad), reading(good, temperature=34.0), reading(bad))
        assert near.value == pytest.approx(0.0001)
        far = gyro_check(ardupilot_parameters, gyro_fit, reading(good), reading(bad, temperature=34.1))
        assert far.value == pytest.approx(0.02)
        unknown = gyro_check(ardupilot_parameters, gyro_fit, reading(bad, temperature=None), reading(good))
        assert unknown.value == pytest.approx(0.0001)

    def test_only_what_was_written_fitted_and_streamed_is_judged(self, ardupilot_parameters, gyro_fit, make_fit):
        now = {GYRO: (reading([0, 0, 0]),)}
        assert len(checks(ardupilot_parameters, {GYRO: gyro_fit}, now)) == 1
        assert checks(ardupilot_parameters, {GYRO: gyro_fit}, {}) == ()
        assert checks(ardupilot_parameters, {GYRO: gyro_fit}, now, raw={GYRO}) == ()
        assert checks(ardupilot_parameters, {GYRO: gyro_fit}, now, changed=[ACCEL]) == ()
        assert checks(ardupilot_parameters, {GYRO: None}, now) == ()
        mag = Subject(Sensor.MAG, 0)
        change = Change("COMPASS_OFS_X", 0.0, 0.5, ParameterKind.REAL32, "", sensor=Sensor.MAG)
        force = force_of("ardupilot", ardupilot_parameters, (change,))
        pairs = {mag: Pair(mag, make_fit(Sensor.MAG), None)}
        seen = StreamEvidence({mag: (reading([40, 0, 0]),)}, {}, frozenset())
        assert sensor_checks(WritePlan(None, "", (change,)), pairs, seen, force) == ()


@pytest.fixture
def accel_fit(make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.3, 0.1, -0.2], matrix=np.diag([1.02, 0.97, 1.01]), residual_rms=0.004)
    root = 1e-3 * np.random.default_rng(4).normal(size=(12, 12))
    return dataclasses.replace(fit, covariance=root @ root.T)


DOWN = np.array([0.5, -1.0, -9.7])


def of_length(fit, raw, undetermined=()):
    """Variance of what the fit makes of `raw`, by finite differences."""

    def length(z):
        matrix = fit.model.matrix + z[3:].reshape(3, 3)
        return np.linalg.norm(matrix @ (raw - fit.model.offset - z[:3]))

    row = np.array([(length(h) - length(-h)) / 2e-5 for h in 1e-5 * np.eye(12)])
    covariance = fit.covariance + np.diag([0.25 * (n in undetermined) for n in fit.names[:12]])
    return row @ covariance @ row


class TestAccel:
    def limit_of(self, fit, mean, *, undetermined=(), misfit=0.004, spread=SPREAD):
        raw = mean + np.array([0.5, 0.0, 0.0])  # the offset in force is 0.5 along x and the scales are one
        normal = mean / np.linalg.norm(mean)
        variance = normal @ spread @ normal + of_length(fit, raw, undetermined)
        sd = np.sqrt(variance + misfit**2 + 1e-3**2)
        return sd, 5.0 * sd + 0.03

    def test_the_limit_of_a_length_is_what_moves_it(self, ardupilot_parameters, accel_fit):
        (check,) = checks(ardupilot_parameters, {ACCEL: accel_fit}, {ACCEL: (reading(DOWN),)})
        sd, limit = self.limit_of(accel_fit, DOWN)
        assert check.value == pytest.approx(abs(np.linalg.norm(DOWN) - G))
        assert check.sd == pytest.approx(sd, rel=1e-5)
        assert check.limit == pytest.approx(limit, rel=1e-5)
        assert (check.id, check.unit, check.verdict) == ("accel_gravity", "m/s2", SensorVerdict.RIGHT)
        off = np.linalg.norm(DOWN) - G
        assert check.text == f"accel 1 reads {off:+.3f} m/s2 beside gravity at rest; the limit is {limit:.3f} m/s2"

    def test_temperature_and_losses_widen_it(self, ardupilot_parameters, accel_fit):
        loss = Loss(Sensor.ACCEL, 0, "cross terms", 0.02, "m/s2", "")
        askew = Loss(Sensor.ACCEL, 0, "mounting", 0.4, "m/s2", "")
        now = {ACCEL: (reading(DOWN, temperature=30.0),)}
        (check,) = checks(ardupilot_parameters, {ACCEL: accel_fit}, now, losses=[loss, askew])
        assert check.limit == pytest.approx(self.limit_of(accel_fit, DOWN)[1] + 2 * 5e-3 * 2.0 + 0.02, rel=1e-5)
        far = {ACCEL: (reading(DOWN, temperature=70.0),)}
        (check,) = checks(ardupilot_parameters, {ACCEL: accel_fit}, far)
        assert check.limit == pytest.approx(self.limit_of(accel_fit, DOWN)[1] + 0.1, rel=1e-5)

    def test_a_measured_drift_leaves_what_a_thermal_job_aims_at(self, ardupilot_parameters, accel_fit, make_fit):
        drift = make_fit(Sensor.ACCEL, polynomial=CURVE, polynomial_sd=1e-5)
        now = {ACCEL: (reading(DOWN, temperature=50.0),)}
        (check,) = checks(ardupilot_parameters, {ACCEL: accel_fit}, now, drift=drift)
        assert check.limit == pytest.approx(self.limit_of(accel_fit, DOWN)[1] + 0.02, rel=1e-5)

    def test_an_open_parameter_may_be_half_a_metre_off_and_then_nothing_is_said(self, ardupilot_parameters, accel_fit):
        side = np.array([0.02, 9.8, 0.05])
        for name, verdict in (("offset_x", "right"), ("offset_y", "not_observable")):
            fit = dataclasses.replace(accel_fit, undetermined=(name,))
            (check,) = checks(ardupilot_parameters, {ACCEL: fit}, {ACCEL: (reading(side),)})
            assert check.verdict == verdict
        fit = dataclasses.replace(accel_fit, undetermined=("offset_x",))
        (check,) = checks(ardupilot_parameters, {ACCEL: fit}, {ACCEL: (reading(side),)})
        assert check.limit == pytest.approx(self.limit_of(fit, side, undetermined=("offset_x",))[1], rel=1e-4)

    def test_a_misfit_that_is_not_known_is_none(self, ardupilot_parameters, accel_fit):
        fit = dataclasses.replace(accel_fit, residual_rms=np.nan)
        (check,) = checks(ardupilot_parameters, {ACCEL: fit}, {ACCEL: (reading(DOWN),)})
        assert check.limit == pytest.approx(self.limit_of(fit, DOWN, misfit=0.0)[1], rel=1e-5)

    @pytest.mark.parametrize(("tilt", "judged"), [(0.0, True), (14.0, True), (16.0, False), (180.0, False)])
    def test_an_offset_without_a_scale_holds_in_the_pose_of_its_fit(
        self, ardupilot_parameters, accel_fit, tilt, judged
    ):
        covariance = accel_fit.covariance.copy()
        covariance[3:, :] = covariance[:, 3:] = 0.0
        tilt = np.radians(tilt)
        mean = [-0.5, 9.8 * np.sin(tilt), -9.8 * np.cos(tilt)]
        native = {"mean": [0.0, 0.0, -4.0]}
        fit = dataclasses.replace(accel_fit, covariance=covariance, native=native)
        (check,) = checks(ardupilot_parameters, {ACCEL: fit}, {ACCEL: (reading(mean),)})
        assert (check.verdict != SensorVerdict.NOT_OBSERVABLE) == judged
        silent = dataclasses.replace(fit, native={})
        (check,) = checks(ardupilot_parameters, {ACCEL: silent}, {ACCEL: (reading(mean),)})
        assert check.verdict == SensorVerdict.NOT_OBSERVABLE

    def test_another_pose_is_judged_by_itself(self, ardupilot_parameters, accel_fit):
        good, tilted = G * np.array([0, 0, -1.0]), 10.1 * np.array([0, np.sin(0.27), -np.cos(0.27)])
        near = 10.1 * np.array([0, np.sin(0.25), -np.cos(0.25)])
        for other, worst in ((near, 0.0), (tilted, 10.1 - G)):
            (check,) = checks(ardupilot_parameters, {ACCEL: accel_fit}, {ACCEL: (reading(good), reading(other))})
            assert check.value == pytest.approx(worst, abs=1e-9)

    @pytest.mark.parametrize(("degrees", "apart", "verdict"), [(2.5, 0.0, "wrong"), (1.5, 0.4, "right")])
    def test_two_of_one_board_agree_about_down(self, ardupilot_parameters, accel_fit, degrees, apart, verdict):
        angle = np.radians(degrees)
        turned = G * np.array([0, np.sin(angle), -np.cos(angle)])
        spread = np.diag([1e-8, 2e-8, 3e-8])
        now = {
            ACCEL: (reading([0, 0, -5 * G], t=1.0), reading([0, 0, -2 * G], t=5.0, covariance=spread)),
            SECOND: (reading([0, 9.0, 0], t=9.0), reading(turned, t=5.0 + apart)),
        }
        found = checks(ardupilot_parameters, {ACCEL: accel_fit, SECOND: accel_fit}, now)
        assert [(c.id, c.instance) for c in found] == [
            ("accel_gravity", 0),
            ("accel_gravity", 1),
            ("accel_direction", 1),
        ]
        check = found[2]
        sd = np.sqrt(6e-8 + 14e-8) / G
        assert check.value == pytest.approx(angle)
        assert check.sd == pytest.approx(sd)
        assert check.limit == pytest.approx(np.radians(2.0) + 5.0 * sd)
        assert (check.unit, check.verdict) == ("rad", verdict)
        assert check.text.startswith(f"accel 2 and accel 1 differ by {degrees} deg about which way is down")

    def test_readings_half_a_second_apart_are_not_of_one_moment(self, ardupilot_parameters, accel_fit):
        now = {ACCEL: (reading([0, 0, -G], t=1.0),), SECOND: (reading([0, 0, -G], t=1.5),)}
        found = checks(ardupilot_parameters, {ACCEL: accel_fit, SECOND: accel_fit}, now)
        assert found[2].verdict == SensorVerdict.NOT_OBSERVABLE
