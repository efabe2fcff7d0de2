"""Streams are made by a sensor of known truth through the correction that is really in force."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Rounding, Sensor, Stage
from mavcal.calib.triad import TriadModel

LEVEL = (0.0, 0.0, -STANDARD_GRAVITY)
LEFT = (0.0, STANDARD_GRAVITY, 0.0)
NOSE_DOWN = (-STANDARD_GRAVITY, 0.0, 0.0)
NOISE = {Sensor.ACCEL: 0.003, Sensor.GYRO: 2e-4}


def stream(rng, sensors, parameters, poses=(LEVEL,), *, hold=4.0, start=0.0, rate=50.0, quantum=0.0, instance=0):
    """What an ArduPilot with `parameters` streams of `sensors` (true models) held in `poses`."""
    channels = []
    for sensor, truth in sensors.items():
        model = ardupilot.calibration_in_force(parameters, sensor, instance)
        values = []
        for pose in poses:
            vector = pose if sensor == Sensor.ACCEL else (0.0, 0.0, 0.0)
            count = int(hold * rate)
            measured = truth.invert(np.tile(vector, (count, 1))) + rng.normal(0, NOISE[sensor], (count, 3))
            values.append(model.apply(measured, np.full(count, 32.0)))
        corrected = np.concatenate(values)
        zero = None
        if quantum:
            counts = np.trunc(corrected / quantum)
            zero = counts == 0
            corrected = (counts + 0.5 * np.sign(counts)) * quantum
        t = start + np.arange(len(corrected)) / rate
        unit = "m/s2" if sensor == Sensor.ACCEL else "rad/s"
        rounding = Rounding.TOWARD_ZERO if quantum else Rounding.NONE
        channels.append(Channel(sensor, instance, t, corrected, unit, Stage.FILTERED, "TEST", quantum, rounding, zero))
        channels.append(
            Channel(Sensor.TEMPERATURE, instance, t[::50], np.full(len(t[::50]), 32.0), "degC", Stage.RAW, "TEST")
        )
    return Recording(tuple(channels), ParameterTimeline.constant(parameters))


def gyro_case(make_fit, parameters, fingerprint, bias, *, sd=2e-5):
    truth = TriadModel(offset=bias)
    fit = make_fit(Sensor.GYRO, offset=bias, offset_sd=sd)
    return {Sensor.GYRO: truth}, [fit], compose([fit], parameters, fingerprint)


def accel_case(make_fit, parameters, fingerprint, truth):
    fit = make_fit(Sensor.ACCEL, offset=truth.offset, matrix=truth.matrix, offset_sd=1e-3, matrix_sd=1e-4)
    return {Sensor.ACCEL: truth}, [fit], compose([fit], parameters, fingerprint)


def verdicts(plan, fits, sensors, parameters, applied, *, seed=0, poses=(LEVEL,), before=True, **more):
    rng = np.random.default_rng(seed)
    now = parameters | {c.name: c.new for c in plan.changes if c.name in applied}
    earlier = stream(rng, sensors, parameters, **more) if before else None
    later = stream(rng, sensors, now, poses, start=10.0, **more)
    stored = parameters | {c.name: c.new for c in plan.changes}
    verification = verify(plan, fits, earlier, later, parameters=stored)
    return {p.name: p.verdict for p in verification.parameters}, verification


def names_of(plan):
    return {c.name for c in plan.changes}


def test_gyro_offsets_in_force_are_proved(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    case = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    sensors, fits, plan = case
    for before in (True, False):
        found, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan), before=before)
        assert {n: v for n, v in found.items() if "OFFS" in n} == dict.fromkeys(
            (f"INS_GYROFFS_{a}" for a in "XYZ"), ProofVerdict.PROVED
        )
        caltemp = next(p for p in verification.parameters if p.name == "INS_GYR1_CALTEMP")
        assert not caltemp.acts_on_stream
        assert caltemp.verdict == ProofVerdict.NOT_OBSERVABLE
        assert verification.proved
        assert verification.movement is None
        x = next(p for p in verification.parameters if p.name == "INS_GYROFFS_X")
        assert (x.effect, x.unit) == (pytest.approx(0.01, rel=1e-6), "rad/s")
        assert 0 < x.sd < 1e-3


@pytest.mark.parametrize("refused", ["X", "Y", "Z", "XY", "XYZ"])
def test_gyro_offsets_that_were_accepted_but_not_applied_are_named(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, refused
):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    bad = {f"INS_GYROFFS_{a}" for a in refused}
    for before in (True, False):
        found, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan) - bad, before=before)
        assert set(verification.contradicted) == bad
        assert not verification.proved
        assert all(v == ProofVerdict.PROVED for n, v in found.items() if "OFFS" in n and n not in bad)


def test_a_truncated_stream_proves_what_is_larger_than_its_bins(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.0004])
    found, _ = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan), quantum=1e-3)
    assert found["INS_GYROFFS_X"] == found["INS_GYROFFS_Y"] == ProofVerdict.PROVED
    assert found["INS_GYROFFS_Z"] == ProofVerdict.NOT_OBSERVABLE


TRUTH = TriadModel([0.3, -0.2, 0.15], [[1.01, 0.002, 0], [0.002, 0.98, -0.001], [0, -0.001, 1.015]])


def test_one_level_pose_proves_the_offsets_and_asks_for_the_faces_that_prove_the_scales(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, TRUTH)
    found, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan))
    assert found["INS_ACCOFFS_X"] == found["INS_ACCOFFS_Y"] == ProofVerdict.PROVED
    assert found["INS_ACCSCAL_X"] == found["INS_ACCSCAL_Y"] == ProofVerdict.NOT_OBSERVABLE
    assert verification.contradicted == ()
    assert "nose" in verification.movement.text
    assert "side" in verification.movement.text

    found, verification = verdicts(
        plan, fits, sensors, ardupilot_parameters, names_of(plan), poses=(LEVEL, LEFT, NOSE_DOWN)
    )
    assert verification.proved
    assert verification.movement is None


@pytest.mark.parametrize("bad", [{"INS_ACCSCAL_Y"}, {"INS_ACCOFFS_Z"}, {"INS_ACCSCAL_X", "INS_ACCOFFS_X"}])
def test_an_accelerometer_value_that_did_not_take_effect_is_named(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, bad
):
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, TRUTH)
    _, verification = verdicts(
        plan, fits, sensors, ardupilot_parameters, names_of(plan) - bad, poses=(LEVEL, LEFT, NOSE_DOWN)
    )
    assert set(verification.contradicted) == bad


def test_a_vehicle_that_was_moved_between_the_captures_is_judged_by_lengths(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, TRUTH)
    found, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan), poses=(LEFT,))
    assert found["INS_ACCOFFS_Y"] in (ProofVerdict.PROVED, ProofVerdict.CONSISTENT)
    assert found["INS_ACCOFFS_X"] == ProofVerdict.NOT_OBSERVABLE
    assert verification.contradicted == ()


def test_values_that_nobody_wrote_leave_the_sensor_wrong(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    rng = np.random.default_rng(3)
    other = ardupilot_parameters | {f"INS_GYROFFS_{a}": 0.05 for a in "XYZ"}
    stored = ardupilot_parameters | {c.name: c.new for c in plan.changes}
    verification = verify(
        plan,
        fits,
        stream(rng, sensors, ardupilot_parameters),
        stream(rng, sensors, other, start=9.0),
        parameters=stored,
    )
    assert verification.contradicted == ()  # the old values are not in force either
    assert "scatter more than noise and fit explain" in verification.parameters[1].text
    assert "gyro 1 reads" in verification.must_go


def test_nothing_streamed_is_not_observable(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    _, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.005])
    empty = Recording((), ParameterTimeline.constant(ardupilot_parameters))
    verification = verify(plan, fits, None, empty)
    assert {p.verdict for p in verification.parameters} == {ProofVerdict.NOT_OBSERVABLE}
    assert not verification.proved
    assert verification.movement.text.startswith("Hold the vehicle still")


@pytest.mark.parametrize("size", [5.5, 8.0, 20.0])
def test_power_and_false_alarms(ardupilot_parameters, ardupilot_fingerprint, make_fit, size):
    """Changes of `size` standard deviations of the check, not applied and applied, many times."""
    _, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01] * 3)
    _, verification = verdicts(plan, fits, {Sensor.GYRO: TriadModel([0.01] * 3)}, ardupilot_parameters, names_of(plan))
    sd = next(p.sd for p in verification.parameters if p.name == "INS_GYROFFS_X")
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [size * sd, 0.01, 0.01])
    runs, caught, claimed, alarms = 60, 0, 0, 0
    for seed in range(runs):
        found, _ = verdicts(
            plan, fits, sensors, ardupilot_parameters, names_of(plan) - {"INS_GYROFFS_X"}, seed=seed, hold=2.0
        )
        caught += found["INS_GYROFFS_X"] == ProofVerdict.CONTRADICTED
        claimed += found["INS_GYROFFS_X"] == ProofVerdict.PROVED
        _, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan), seed=seed, hold=2.0)
        alarms += len(verification.contradicted)
    assert claimed == 0
    assert alarms == 0
    assert caught >= (0.9 * runs if size < 8 else runs)


def test_a_table_that_gives_way_a_little_is_no_contradiction(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    truth = TriadModel([0.02, 0.02, 0.15], np.diag([1.01, 0.98, 1.015]))
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, truth)
    # leaning by 0.12 deg reads like an x offset of 0.02 m/s2 that was not applied
    leaning = (0.02, 0.0, -np.sqrt(STANDARD_GRAVITY**2 - 0.02**2))
    _, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan), poses=(leaning,))
    assert verification.contradicted == ()


def test_nobody_is_sent_to_move_a_vehicle_for_changes_that_no_pose_shows(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    truth = TriadModel([1e-4, -1e-4, 1e-4], np.diag([1 + 1e-5, 1 - 1e-5, 1 + 1e-5]))
    sensors, fits, plan = accel_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, truth)
    found, verification = verdicts(plan, fits, sensors, ardupilot_parameters, names_of(plan))
    assert set(found.values()) == {ProofVerdict.NOT_OBSERVABLE}
    assert verification.movement is None
