"""A sensor must read right after a write: that of another, equal vehicle acts and leaves it wrong."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.plan import ProofVerdict, SensorVerdict
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.recording import Sensor, join
from mavcal.calib.triad import TriadModel

from .test_verify import LEFT, LEVEL, NOSE_DOWN, accel_case, gyro_case, stream

HEALTHY = 200


def written(plan, fits, sensors, parameters, *, seed=0, poses=(LEVEL,), **more):
    """The check of `plan` on a vehicle with `sensors`, everything applied."""
    rng = np.random.default_rng(seed)
    now = parameters | {c.name: c.new for c in plan.changes}
    earlier = stream(rng, sensors, parameters, **more)
    later = stream(rng, sensors, now, poses, start=10.0, **more)
    return verify(plan, fits, earlier, later, parameters=now)


def only(result, id_):
    (check,) = [c for c in result.sensors if c.id == id_]
    return check


def test_a_gyro_that_reads_zero_is_right(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    result = written(plan, fits, sensors, ardupilot_parameters)
    check = only(result, "gyro_zero")
    assert (check.sensor, check.instance, check.unit, check.verdict) == (Sensor.GYRO, 0, "rad/s", SensorVerdict.RIGHT)
    assert check.value < 4e-4 < check.limit < 3e-3
    assert result.proved
    assert result.must_go == ""


def test_gyro_offsets_of_another_vehicle_are_refuted_although_they_act(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    _, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    mine = {Sensor.GYRO: TriadModel([0.012, -0.013, 0.004])}
    result = written(plan, fits, mine, ardupilot_parameters)
    assert {p.verdict for p in result.parameters if "OFFS" in p.name} == {ProofVerdict.PROVED}
    assert not result.proved
    (check,) = result.refuted
    assert (check.id, check.verdict) == ("gyro_zero", SensorVerdict.WRONG)
    assert check.value == pytest.approx(0.007, abs=3e-4)
    assert check.text.startswith("gyro 1 reads +0.4")
    assert check.text in result.must_go


def test_a_gyro_that_is_turned_while_it_is_read_is_right_as_soon_as_it_rests(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    rng = np.random.default_rng(1)
    now = ardupilot_parameters | {c.name: c.new for c in plan.changes}
    turning = {Sensor.GYRO: TriadModel([0.01, -0.02, 0.035])}  # a steady 1.7 deg/s about the vertical
    earlier = stream(rng, sensors, ardupilot_parameters)
    disturbed = stream(rng, turning, now, start=10.0)
    rest = stream(rng, sensors, now, start=20.0)
    assert verify(plan, fits, earlier, disturbed, parameters=now).refuted
    assert not verify(plan, fits, earlier, join([disturbed, rest]), parameters=now).refuted


def test_an_accelerometer_is_right_where_it_reads_gravity(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    truth = TriadModel([0.3, -0.2, 0.15], np.diag([1.01, 0.98, 1.015]))
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, truth)
    poses = (LEVEL, LEFT, NOSE_DOWN)
    assert only(written(plan, fits, sensors, ardupilot_parameters, poses=poses), "accel_gravity").verdict == "right"
    other = {Sensor.ACCEL: TriadModel([0.3, -0.2, 0.35], np.diag([1.01, 0.98, 1.015]))}
    (check,) = written(plan, fits, other, ardupilot_parameters, poses=poses).refuted
    assert check.value == pytest.approx(0.2, abs=0.02)
    assert "m/s2 beside gravity" in check.text


def test_what_was_not_at_rest_is_not_judged(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    rng = np.random.default_rng(5)
    now = ardupilot_parameters | {c.name: c.new for c in plan.changes}
    after = stream(rng, sensors, now, start=10.0, hold=0.3)
    check = only(verify(plan, fits, None, after, parameters=now), "gyro_zero")
    assert (check.verdict, check.value, check.limit) == (SensorVerdict.NOT_OBSERVABLE, None, None)


@pytest.mark.long
def test_healthy_writes_are_hardly_ever_refused(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    """Random sensors, quantised streams, and up to 2 degC and two minutes of drift between the fit and the check."""
    refused = []
    for seed in range(HEALTHY):
        rng = np.random.default_rng([seed, 77])
        gyro = rng.uniform(-0.03, 0.03, 3)
        matrix = np.diag(rng.uniform(0.975, 1.025, 3))
        accel = TriadModel(rng.uniform(-0.4, 0.4, 3), matrix)
        heat = rng.uniform(0.0, 2.0)
        drifts = {Sensor.GYRO: 7e-4 * heat + 1.5e-5 * rng.uniform(0, 120), Sensor.ACCEL: 7e-3 * heat}
        fits = [
            make_fit(Sensor.GYRO, offset=gyro + rng.normal(0, 2e-5, 3), offset_sd=2e-5, temperature=32.0 - heat),
            make_fit(
                Sensor.ACCEL,
                offset=accel.offset + rng.normal(0, 2e-3, 3),
                matrix=matrix + np.diag(rng.normal(0, 3e-4, 3)),
                offset_sd=2e-3,
                matrix_sd=3e-4,
                temperature=32.0 - heat,
            ),
        ]
        signs = rng.choice([-1.0, 1.0], 3)
        now = {
            Sensor.GYRO: TriadModel(gyro + signs * drifts[Sensor.GYRO]),
            Sensor.ACCEL: TriadModel(accel.offset + signs * drifts[Sensor.ACCEL], matrix),
        }
        plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint)
        quantum = 1e-3 if seed % 2 else 0.0
        result = written(plan, fits, now, ardupilot_parameters, seed=seed, hold=3.0, quantum=quantum)
        assert {c.verdict for c in result.sensors} <= {SensorVerdict.RIGHT, SensorVerdict.WRONG}
        if result.must_go:
            refused.append((seed, result.must_go))
    assert refused == []


def test_offsets_of_another_vehicle_are_refuted(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    """Offsets of ordinary parts, 0.3 to 1.7 deg/s an axis, of one vehicle on another; some are alike by chance."""
    missed = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 78])
        own, foreign = (rng.uniform(5e-3, 30e-3, 3) * rng.choice([-1, 1], 3) for _ in range(2))
        _, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, foreign)
        result = written(plan, fits, {Sensor.GYRO: TriadModel(own)}, ardupilot_parameters, seed=seed, hold=2.0)
        if not result.refuted:
            missed.append(np.abs(own - foreign).max())
    assert len(missed) <= 1
    assert all(apart < np.radians(0.15) for apart in missed)
