"""The physical check beside gyroscopes and accelerometers of ArduPilot: PX4, compasses, temperature, trims."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.fitted import contents
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.compose.trim import force_when_level, trim_from_force
from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, ProofVerdict, WritePlan
from mavcal.calib.firmware.proof.check import MOST, PRICE, outliers
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.fit import parameter_names
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Rounding, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel

LEVEL = np.array([0.0, 0.0, -STANDARD_GRAVITY])
FIELD = np.array([20.0, 3.0, 43.0])
NOISE = {Sensor.ACCEL: 0.003, Sensor.GYRO: 2e-4, Sensor.MAG: 0.3}
UNIT = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
N = 30
EVERY = np.ones(N, dtype=bool)


def channel(rng, sensor, truth, model, vectors, *, start, rate, temperature, stage=Stage.FILTERED):
    n = len(vectors)
    heat = np.full(n, temperature)
    measured = truth.invert(vectors, heat) + rng.normal(0, NOISE[sensor], (n, 3))
    values = measured if stage == Stage.RAW else model.apply(measured, heat)
    return Channel(sensor, 0, start + np.arange(n) / rate, values, UNIT[sensor], stage, "TEST")


def still(rng, truths, models, *, start=0.0, seconds=5.0, temperature=32.0, mag_stage=Stage.FILTERED, down=LEVEL):
    """A vehicle that reads `down` at rest: accelerometer and gyroscope at 50 Hz, compass at 10 Hz."""
    vectors = {Sensor.ACCEL: down, Sensor.GYRO: np.zeros(3), Sensor.MAG: FIELD}
    found = []
    for sensor, truth in truths.items():
        rate = 10.0 if sensor == Sensor.MAG else 50.0
        stage = mag_stage if sensor == Sensor.MAG else Stage.FILTERED
        rows = np.tile(vectors[sensor], (int(seconds * rate), 1))
        found.append(
            channel(
                rng, sensor, truth, models[sensor], rows, start=start, rate=rate, temperature=temperature, stage=stage
            )
        )
    t = start + np.arange(int(seconds))
    found.append(Channel(Sensor.TEMPERATURE, 0, t, np.full(len(t), temperature), "degC", Stage.RAW, "TEST"))
    return Recording(tuple(found))


PERFECT = {Sensor.ACCEL: TriadModel(), Sensor.GYRO: TriadModel()}


def run(module, plan, fits, truths, parameters, applied, *, temperature=32.0, seed=0, memory=None, **more):
    """Streams before with `parameters`, after with `applied` (names) in force as well."""
    rng = np.random.default_rng(seed)
    now = parameters | {c.name: c.new for c in plan.changes if c.name in applied}
    known = ParameterTimeline.constant(parameters | {c.name: c.new for c in plan.changes})

    def models(values):
        return {s: module.calibration_in_force(values, s, 0) for s in truths}

    later = models(now) | (memory or {})
    before = still(rng, truths, models(parameters), temperature=temperature, **more)
    after = still(rng, truths, later, start=9.0, temperature=temperature, **more)
    result = verify(plan, fits, before, after, parameters=known.final())
    return {p.name: p.verdict for p in result.parameters}, result


def every(plan):
    return {c.name for c in plan.changes}


def test_px4_values_that_its_memory_does_not_take_are_contradicted(px4_parameters, px4_fingerprint, make_fit):
    truths = PERFECT | {Sensor.ACCEL: TriadModel([0.31, -0.22, 0.17], np.diag([1.021, 0.984, 1.013]))}
    fit = make_fit(Sensor.ACCEL, offset=[0.31, -0.22, 0.17], matrix=np.diag([1.021, 0.984, 1.013]), matrix_sd=1e-4)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    found, _ = run(px4, plan, [fit], truths, px4_parameters, every(plan))
    assert found["CAL_ACC0_XOFF"] == found["CAL_ACC0_YOFF"] == ProofVerdict.PROVED
    assert ProofVerdict.CONTRADICTED not in found.values()

    stale = px4.calibration_in_force(px4_parameters, Sensor.ACCEL, 0)
    _, result = run(px4, plan, [fit], truths, px4_parameters, every(plan), memory={Sensor.ACCEL: stale})
    assert {"CAL_ACC0_XOFF", "CAL_ACC0_YOFF"} <= set(result.contradicted)


def test_px4_restart_that_did_not_happen_is_seen(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_GYRO0_XOFF": 0.02, "CAL_GYRO0_YOFF": 0.0, "CAL_GYRO0_ZOFF": 0.0}
    truths = PERFECT | {Sensor.GYRO: TriadModel([0.024, 0.003, -0.004])}
    fit = make_fit(Sensor.GYRO, offset=[0.024, 0.003, -0.004], offset_sd=2e-5)
    plan = compose([fit], parameters, px4_fingerprint)
    assert plan.needs_reboot
    found, _ = run(px4, plan, [fit], truths, parameters, every(plan))
    assert [found[f"CAL_GYRO0_{a}OFF"] for a in "XYZ"] == [ProofVerdict.PROVED] * 3
    stale = px4.calibration_in_force(parameters, Sensor.GYRO, 0)
    _, result = run(px4, plan, [fit], truths, parameters, every(plan), memory={Sensor.GYRO: stale})
    assert set(result.contradicted) == {f"CAL_GYRO0_{a}OFF" for a in "XYZ"}


SOFT = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])


BODY = TriadModel([9.0, -5.5, 3.5], SOFT)


KNOWN = {"radius": float(np.linalg.norm(FIELD)), "field_ratio": 1.0}


def test_px4_streams_its_magnetometer_raw_so_nothing_can_be_seen(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.MAG, offset=BODY.offset, matrix=SOFT, offset_sd=0.02, matrix_sd=5e-4, quality=KNOWN)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    truths = PERFECT | {Sensor.MAG: BODY}
    found, result = run(px4, plan, [fit], truths, px4_parameters, every(plan), mag_stage=Stage.RAW)
    assert set(found.values()) == {ProofVerdict.NOT_OBSERVABLE}
    assert not any(p.acts_on_stream for p in result.parameters)
    assert not result.proved
    assert result.movement is None


def mag_plan(parameters, fingerprint, make_fit):
    fit = make_fit(
        Sensor.MAG,
        offset=BODY.offset,
        matrix=SOFT,
        offset_sd=0.02,
        matrix_sd=5e-4,
        quality=KNOWN,
        residual_rms=0.3,
        temperature=None,
    )
    return fit, compose([fit], parameters, fingerprint)


def test_a_compass_at_rest_proves_its_offsets_and_asks_to_be_turned(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit, plan = mag_plan(ardupilot_parameters, ardupilot_fingerprint, make_fit)
    truths = PERFECT | {Sensor.MAG: BODY}
    found, result = run(ardupilot, plan, [fit], truths, ardupilot_parameters, every(plan))
    assert found["COMPASS_OFS_X"] == found["COMPASS_OFS_Y"] == ProofVerdict.PROVED
    assert found["COMPASS_SCALE"] == ProofVerdict.NOT_OBSERVABLE
    assert not {p.name: p.acts_on_stream for p in result.parameters}["COMPASS_SCALE"]
    assert not result.contradicted

    bad = {f"COMPASS_OFS_{a}" for a in "XYZ"}
    _, result = run(ardupilot, plan, [fit], truths, ardupilot_parameters, every(plan) - bad)
    assert result.contradicted


@pytest.mark.parametrize("bad", [set(), {f"COMPASS_ODI_{a}" for a in "XYZ"}, {"COMPASS_OFS_X"}])
def test_a_compass_that_is_turned_shows_the_strength_of_the_field_everywhere(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, bad
):
    fit, plan = mag_plan(ardupilot_parameters, ardupilot_fingerprint, make_fit)
    rng = np.random.default_rng(2)
    now = ardupilot_parameters | {c.name: c.new for c in plan.changes if c.name not in bad}
    directions = rng.normal(size=(300, 3))
    vectors = np.linalg.norm(FIELD) * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    model = ardupilot.calibration_in_force(now, Sensor.MAG, 0)
    turned = channel(rng, Sensor.MAG, BODY, model, vectors, start=0.0, rate=10.0, temperature=32.0)
    stored = ardupilot_parameters | {c.name: c.new for c in plan.changes}
    result = verify(plan, [fit], None, Recording((turned,)), parameters=stored)
    assert set(result.contradicted) == bad
    assert sum(p.verdict == ProofVerdict.PROVED for p in result.parameters) == 9 - len(bad)
    assert result.proved == (not bad)


CURVE = ThermalPolynomial(35.0, 10.0, 60.0, [[7e-4, 6e-6, 1e-8], [-4e-4, -3e-6, 2e-8], [9e-4, 4e-6, 0.0]])


def test_thermal_compensation_away_from_its_reference(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    truth = TriadModel([0.01, -0.02, 0.005], polynomial=CURVE)
    truths = {Sensor.ACCEL: TriadModel(), Sensor.GYRO: truth}
    fit = make_fit(Sensor.GYRO, offset=truth.offset, polynomial=CURVE, polynomial_sd=1e-6, offset_sd=2e-5)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    found, _ = run(ardupilot, plan, [fit], truths, ardupilot_parameters, every(plan), temperature=55.0)
    assert found["INS_GYROFFS_X"] == found["INS_TCAL1_ENABLE"] == found["INS_TCAL1_GYR1_X"] == ProofVerdict.PROVED
    assert found["INS_TCAL1_GYR3_X"] == ProofVerdict.NOT_OBSERVABLE

    found, _ = run(
        ardupilot, plan, [fit], truths, ardupilot_parameters, every(plan) - {"INS_TCAL1_ENABLE"}, temperature=55.0
    )
    assert found["INS_TCAL1_ENABLE"] == ProofVerdict.CONTRADICTED


def test_the_shape_of_an_accelerometer_is_judged_between_the_captures(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    curve = ThermalPolynomial(35.0, 10.0, 60.0, 10 * CURVE.coefficients)
    parameters = ardupilot_parameters | {"INS_ACC1_CALTEMP": 25.0, "INS_ACCOFFS_X": 0.1}
    truths = {Sensor.ACCEL: TriadModel([0.1, 0, 0], polynomial=curve), Sensor.GYRO: TriadModel()}
    undetermined = tuple(f"offset_{a}" for a in "xyz")
    fit = make_fit(Sensor.ACCEL, polynomial=curve, polynomial_sd=1e-6, undetermined=undetermined)
    plan = compose([fit], parameters, ardupilot_fingerprint)
    found, result = run(ardupilot, plan, [fit], truths, parameters, every(plan), temperature=55.0)
    assert found["INS_TCAL1_ENABLE"] == found["INS_TCAL1_ACC1_X"] == ProofVerdict.PROVED
    assert not result.contradicted
    found, _ = run(ardupilot, plan, [fit], truths, parameters, every(plan) - {"INS_TCAL1_ENABLE"}, temperature=55.0)
    assert found["INS_TCAL1_ENABLE"] == ProofVerdict.CONTRADICTED


def test_px4_level_trim_turns_every_stream(px4_parameters, px4_fingerprint, make_fit):
    native = {"roll": 0.03, "pitch": -0.02, "roll_sd": 1e-4, "pitch_sd": 1e-4}
    fit = make_fit(Sensor.ACCEL, method="level", native=native)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    found, result = run(px4, plan, [fit], PERFECT, px4_parameters, every(plan))
    assert set(found.values()) == {ProofVerdict.PROVED}
    assert result.proved
    _, result = run(px4, plan, [fit], PERFECT, px4_parameters, set())
    assert set(result.contradicted) == every(plan)


CALIBRATED = {
    **dict(zip(("CAL_ACC0_XOFF", "CAL_ACC0_YOFF", "CAL_ACC0_ZOFF"), (0.333, -0.248, 0.192), strict=True)),
    **dict(zip(("CAL_ACC0_XSCALE", "CAL_ACC0_YSCALE", "CAL_ACC0_ZSCALE"), (0.983, 1.014, 0.988), strict=True)),
}


"""An accelerometer calibration that a PX4 has in force when its level is trimmed."""


def level_fit(make_fit, roll, pitch, **more):
    native = {"roll": roll, "pitch": pitch, "roll_sd": 1e-4, "pitch_sd": 1e-4}
    return make_fit(Sensor.ACCEL, method="level", offset_sd=0.0, native=native, **more)


def test_px4_level_trim_is_proved_while_an_accelerometer_calibration_is_in_force(
    px4_parameters, px4_fingerprint, make_fit
):
    parameters = px4_parameters | CALIBRATED
    truth = px4.calibration_in_force(parameters, Sensor.ACCEL, 0)
    roll, pitch = np.radians((1.7, -2.3))
    fit = level_fit(make_fit, roll, pitch)
    plan = compose([fit], parameters, px4_fingerprint)
    board = force_when_level(roll, pitch)
    truths = PERFECT | {Sensor.ACCEL: truth}
    found, result = run(px4, plan, [fit], truths, parameters, every(plan), down=board)
    assert set(found) == {"SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF"}
    assert set(found.values()) == {ProofVerdict.PROVED}
    assert result.proved
    _, result = run(px4, plan, [fit], truths, parameters, set(), down=board)
    assert set(result.contradicted) == every(plan)


@pytest.mark.parametrize("method", ["level", "mag-motor", "allan", "rest-reference", "gyro-g-sensitivity"])
def test_what_is_no_correction_says_nothing_of_where_a_sensor_should_stand(make_fit, method):
    undetermined = parameter_names() if method in ("allan", "rest-reference") else ()
    sensor = {"mag-motor": Sensor.MAG, "gyro-g-sensitivity": Sensor.GYRO}.get(method, Sensor.ACCEL)
    fit = make_fit(sensor, method=method, undetermined=undetermined)
    assert contents([fit]).corrections == ()


def test_the_level_trim_of_a_real_px4_is_proved(px4_parameters, px4_fingerprint, make_fit):
    """What SCALED_IMU of PX4 main read in mg, held at roll 1.7 and pitch -2.3 deg, before and after the write."""
    parameters = px4_parameters | CALIBRATED
    fit = level_fit(make_fit, *trim_from_force(np.array([-39.5, -29.2, -998.0])), temperature=18.0)
    plan = compose([fit], parameters, px4_fingerprint)
    rng = np.random.default_rng(4)

    def scaled_imu(mean, start):
        t = start + np.arange(200) / 50.0
        mg = STANDARD_GRAVITY / 1000.0
        counts = np.trunc(mean + rng.normal(0.0, 2.0, (200, 3)))
        zero = counts == 0
        values = (counts + 0.5 * np.sign(counts)) * mg
        accel = Channel(
            Sensor.ACCEL, 0, t, values, "m/s2", Stage.CORRECTED, "SCALED_IMU", mg, Rounding.TOWARD_ZERO, zero
        )
        gyro = Channel(Sensor.GYRO, 0, t, rng.normal(0.0, 1e-3, (200, 3)), "rad/s", Stage.CORRECTED, "SCALED_IMU")
        heat = Channel(Sensor.TEMPERATURE, 0, t[::50], np.full(4, 18.0), "degC", Stage.RAW, "SCALED_IMU")
        return Recording((accel, gyro, heat))

    stored = parameters | {c.name: c.new for c in plan.changes}
    before, after = scaled_imu([-39.5, -29.2, -998.0], 0.0), scaled_imu([-0.1, 0.2, -999.0], 9.0)
    result = verify(plan, [fit], before, after, parameters=stored)
    assert result.proved, result
    unchanged = scaled_imu([-39.5, -29.2, -998.0], 9.0)
    assert set(verify(plan, [fit], before, unchanged, parameters=stored).contradicted) == every(plan)


def test_ardupilot_level_trim_is_in_no_stream(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    native = {"roll": 0.03, "pitch": -0.02, "roll_sd": 1e-4, "pitch_sd": 1e-4}
    plan = compose([make_fit(Sensor.ACCEL, method="level", native=native)], ardupilot_parameters, ardupilot_fingerprint)
    found, result = run(ardupilot, plan, [], PERFECT, ardupilot_parameters, every(plan))
    assert set(found.values()) == {ProofVerdict.NOT_OBSERVABLE}
    assert not any(p.acts_on_stream for p in result.parameters)


def test_px4_device_id_and_gyro(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_GYRO0_ID": 0}
    truths = PERFECT | {Sensor.GYRO: TriadModel([0.03, -0.02, 0.02])}
    fit = make_fit(Sensor.GYRO, offset=[0.03, -0.02, 0.02], offset_sd=2e-5)
    options = ComposeOptions(device_ids={(Sensor.GYRO, 0): 1310988})
    plan = compose([fit], parameters, px4_fingerprint, options=options)
    found, _ = run(px4, plan, [fit], truths, parameters, every(plan))
    assert [found[f"CAL_GYRO0_{a}OFF"] for a in "XYZ"] == [ProofVerdict.PROVED] * 3


# what a real PX4 did with each write (data/px4_captures/README.txt), and what the stream can say of it: an offset of
# 0.009 m/s2 across gravity is no more than a table that someone leans on, whether it was applied or not
REAL_PX4 = (
    ("CAL_ACC0_XOFF", 0.009, ProofVerdict.NOT_OBSERVABLE),
    ("CAL_ACC0_XOFF", 0.05, ProofVerdict.PROVED),
    ("CAL_ACC0_XOFF", 0.057, ProofVerdict.NOT_OBSERVABLE),
    ("CAL_ACC0_XOFF", 0.0, ProofVerdict.PROVED),
    ("CAL_ACC0_ZSCALE", 1.008, ProofVerdict.CONTRADICTED),
    ("CAL_ACC0_ZSCALE", 1.02, ProofVerdict.PROVED),
    ("CAL_ACC0_ZSCALE", 1.0, ProofVerdict.PROVED),
    ("CAL_GYRO0_XOFF", 0.008, ProofVerdict.CONTRADICTED),
)


@pytest.mark.shared
def test_writes_that_a_real_px4_ignored_are_told_from_those_it_applied(shared_data):
    recording = read_tlog(shared_data / "px4_captures" / "cal_applied.tlog")
    entries = recording.parameters.entries
    for name, value, verdict in REAL_PX4:
        t = next(e.t for e in entries if e.name == name and e.t > 35 and np.float32(e.value) == np.float32(value))
        old = recording.parameters.at(t - 0.5)
        sensor = Sensor.ACCEL if "ACC" in name else Sensor.GYRO
        change = Change(name, old[name], float(np.float32(value)), ParameterKind.REAL32, "test", sensor=sensor)
        plan = WritePlan(Fingerprint("px4", "", "", ()), "0" * 64, (change,))
        before, after = recording.between(t - 4.0, t - 0.2), recording.between(t + 0.5, t + 4.0)
        result = verify(plan, [], before, after, parameters=old | {name: change.new})
        assert result.parameters[0].verdict == verdict, (name, value)


def test_beyond_the_calibrated_temperatures_nothing_is_waited_for(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    truth = TriadModel([0.01, -0.02, 0.005], polynomial=CURVE)
    fit = make_fit(Sensor.GYRO, offset=truth.offset, polynomial=CURVE, polynomial_sd=1e-6, offset_sd=2e-5)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    truths = {Sensor.ACCEL: TriadModel(), Sensor.GYRO: truth}
    _, result = run(ardupilot, plan, [fit], truths, ardupilot_parameters, every(plan), temperature=66.0)
    acting = [p for p in result.parameters if p.acts_on_stream]
    assert {p.verdict for p in acting} == {ProofVerdict.NOT_OBSERVABLE}
    assert all("it will be provable below 60 degC" in p.text for p in acting)
    assert result.movement is None
    assert result.settled


def covariance():
    """Scatter of 0.08 beside a common uncertainty of 0.14, as in the capture of an ArduCopter."""
    return 0.08**2 * np.eye(N) + 0.14**2 * np.ones((N, N))


@pytest.mark.parametrize("seed", range(20))
def test_single_wild_samples_are_found_and_no_healthy_one(seed):
    rng = np.random.default_rng(seed)
    wrong = 2.0 * rng.normal(size=N)  # what the old values would leave
    data = rng.normal(0.0, 0.08, N) + rng.normal(0.0, 0.14)
    assert not outliers(np.array([data, data + wrong]), covariance(), EVERY).any()
    wild = rng.choice(N, 3, replace=False)
    data[wild] -= 0.62
    out = outliers(np.array([data, data + wrong]), covariance(), EVERY)
    assert set(np.flatnonzero(out)) == set(wild)


def test_what_the_old_values_explain_is_not_left_out():
    """The new values would leave out a fifth of the samples; the old ones explain all, and are cheaper."""
    rng = np.random.default_rng(1)
    effect = np.where(np.arange(N) < 5, 1.0, 0.0)
    data = rng.normal(0.0, 0.08, N) + effect  # nothing was applied
    assert not outliers(np.array([data, data - effect]), covariance(), EVERY).any()


def test_no_more_than_a_fifth_and_no_reading_at_rest_is_left_out():
    rng = np.random.default_rng(2)
    data = rng.normal(0.0, 5.0, N)
    assert outliers(data[None], 0.01 * np.eye(N), EVERY).sum() == int(MOST * N)
    moving = np.arange(N) >= 20
    out = outliers(data[None], 0.01 * np.eye(N), moving)
    assert out.sum() == int(MOST * 10)
    assert not out[:20].any()
    assert PRICE > 4.0
