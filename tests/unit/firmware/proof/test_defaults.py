"""The proof on vehicles as the firmwares start: no mixture of old and new values that a vehicle cannot have is asked.

Old values are the factory's, and those that other software leaves: a hidden group whose TMAX is 0, and the zero scale
of an absent accelerometer. Others are an all-zero compass diagonal and gains of rubbish.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.calib.firmware.proof.force import force_of
from mavcal.calib.firmware.proof.hypotheses import combinations_of
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.server import make_vehicle

FIELD = np.array([20.0, 3.0, 43.0])
TRUE = {Sensor.ACCEL: np.array([0.0, 0.0, -STANDARD_GRAVITY]), Sensor.GYRO: np.zeros(3), Sensor.MAG: FIELD}
NOISE = {Sensor.ACCEL: 0.003, Sensor.GYRO: 2e-4, Sensor.MAG: 0.3}
UNIT = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
MODULES = {"ardupilot": ardupilot, "px4": px4}
SOFT = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
WARM = ThermalPolynomial(35.0, 26.3, 58.7, [[7e-4, 6e-6, 1e-8], [-4e-4, -3e-6, 2e-8], [9e-4, 4e-6, 0.0]])
COLD = ThermalPolynomial(-20.0, -30.0, -5.0, WARM.coefficients)
TRUTH = {
    "accel": TriadModel([0.31, -0.22, 0.17], np.diag([1.021, 0.984, 1.013])),
    "gyro": TriadModel([0.024, 0.013, -0.014]),
    "mag": TriadModel([9.0, -5.5, 3.5], SOFT),
    "warm": TriadModel([0.01, -0.02, 0.005], polynomial=WARM),
    "cold": TriadModel([0.01, -0.02, 0.005], polynomial=COLD),
}
SENSOR = {"accel": Sensor.ACCEL, "mag": Sensor.MAG}
HEAT = {"warm": 50.0, "cold": -10.0}

# (autopilot, what is calibrated) and what the vehicle holds before; None: its group is hidden, the name is not listed
STARTS: list[tuple[str, str, dict[str, Any]]] = [
    ("ardupilot", "warm", {"INS_TCAL1_TMIN": 0.0, "INS_TCAL1_TMAX": 0.0}),
    ("ardupilot", "warm", {"INS_TCAL1_TMIN": 0.0, "INS_TCAL1_TMAX": 70.0}),
    ("ardupilot", "warm", {"INS_TCAL1_TMAX": None}),
    ("ardupilot", "cold", {"INS_TCAL1_TMIN": 0.0, "INS_TCAL1_TMAX": 0.0}),
    ("ardupilot", "cold", {"INS_TCAL1_TMIN": 0.0, "INS_TCAL1_TMAX": 70.0}),
    ("ardupilot", "accel", {"INS_ACC1_CALTEMP": -300.0}),
    ("ardupilot", "accel", {f"INS_ACCSCAL_{a}": 0.0 for a in "XYZ"}),
    ("ardupilot", "accel", {"INS_ACCSCAL_Y": 0.0}),
    ("ardupilot", "mag", {"COMPASS_SCALE": 0.0}),
    ("ardupilot", "mag", {f"COMPASS_DIA_{a}": 0.0 for a in "XYZ"}),
    ("ardupilot", "mag", {"COMPASS_DIA_X": 0.0}),
    ("ardupilot", "mag", {"COMPASS_DIA_Z": -1.0}),
    ("px4", "accel", {f"CAL_ACC0_{a}SCALE": 0.0 for a in "XYZ"}),
    ("px4", "accel", {"CAL_ACC0_PRIO": -1}),
    ("px4", "gyro", {"CAL_GYRO0_PRIO": -1}),
    ("px4", "warm", {"TC_G0_ID": 0, "TC_G0_TMIN": 0.0, "TC_G0_TMAX": 100.0, "TC_G0_TREF": 25.0}),
    ("px4", "warm", {"TC_G0_ID": None, "TC_G0_TMIN": None, "TC_G0_TMAX": None, "TC_G0_TREF": None}),
    ("px4", "cold", {"TC_G0_ID": 0, "TC_G0_TMIN": 0.0, "TC_G0_TMAX": 100.0, "TC_G0_TREF": 25.0}),
    ("px4", "cold", {"TC_G0_TMAX": 0.0}),
]


def standing(rng: Any, values: dict[str, Any], module: Any, truth: dict[Sensor, TriadModel], start: float, heat: float):
    """Five seconds at rest under `values`; a correction that cannot be computed streams zeros."""
    channels = [Channel(Sensor.TEMPERATURE, 0, start + np.arange(5.0), np.full(5, heat), "degC", Stage.RAW, "TEST")]
    for sensor, true in truth.items():
        n = 50 if sensor == Sensor.MAG else 250
        temperature = np.full(n, heat)
        raw = true.invert(np.tile(TRUE[sensor], (n, 1)), temperature) + rng.normal(0.0, NOISE[sensor], (n, 3))
        try:
            streamed = module.calibration_in_force(values, sensor, 0).apply(raw, temperature)
        except ValueError:
            streamed = raw
        except Exception:  # noqa: BLE001 - a scale of zero
            streamed = np.zeros_like(raw)
        t = start + np.arange(n) * (5.0 / n)
        channels.append(Channel(sensor, 0, t, streamed, UNIT[sensor], Stage.FILTERED, "TEST"))
    return Recording(tuple(channels))


@pytest.fixture
def started(ardupilot_parameters, px4_parameters, ardupilot_fingerprint, px4_fingerprint, make_fit):
    def start(autopilot, kind, before):
        own = {"ardupilot": ardupilot_parameters, "px4": px4_parameters}[autopilot]
        print_of = {"ardupilot": ardupilot_fingerprint, "px4": px4_fingerprint}[autopilot]
        held = {name: value for name, value in (own | before).items() if value is not None}
        sensor, truth = SENSOR.get(kind, Sensor.GYRO), TRUTH[kind]
        quality = {"radius": float(np.linalg.norm(FIELD)), "field_ratio": 1.0} if kind == "mag" else {}
        fit = make_fit(
            sensor,
            offset=truth.offset,
            matrix=truth.matrix,
            polynomial=truth.polynomial,
            polynomial_sd=1e-6 if truth.polynomial else 0.0,
            offset_sd=0.02 if kind == "mag" else 2e-5,
            matrix_sd={"mag": 5e-4, "accel": 1e-4}.get(kind, 0.0),
            quality=quality,
        )
        rows = {Sensor.ACCEL: "CAL_ACC0_ID", Sensor.GYRO: "CAL_GYRO0_ID", Sensor.MAG: "CAL_MAG0_ID"}
        ids = {(s, 0): 1310988 + k for k, (s, row) in enumerate(rows.items()) if not held.get(row)}
        plan = compose([fit], held, print_of, options=ComposeOptions(device_ids=ids))
        assert plan.changes
        assert not plan.blockers
        return plan, fit, held, {s: TriadModel() for s in (Sensor.ACCEL, Sensor.GYRO)} | {sensor: truth}

    return start


@pytest.mark.sampled
@pytest.mark.parametrize(("autopilot", "kind", "before"), STARTS)
@pytest.mark.parametrize("seed", range(2))
def test_what_was_written_to_a_vehicle_as_it_starts_stays(started, autopilot, kind, before, seed):
    plan, fit, held, truth = started(autopilot, kind, before)
    rng, module, heat = np.random.default_rng(seed), MODULES[autopilot], HEAT.get(kind, 32.0)
    stored = held | {c.name: c.new for c in plan.changes}
    earlier = standing(rng, held, module, truth, 0.0, heat)
    later = standing(rng, stored, module, truth, 9.0, heat)
    result = verify(plan, [fit], earlier, later, parameters=stored)
    assert result.must_go == ""
    assert len(result.parameters) == len(plan.changes)
    if autopilot == "ardupilot" or kind != "mag":
        assert any(p.verdict == ProofVerdict.PROVED for p in result.parameters)


@pytest.mark.sampled
@pytest.mark.parametrize(("autopilot", "kind", "before"), STARTS)
def test_what_had_no_effect_is_still_found(started, autopilot, kind, before):
    """The other side: the same vehicles, with the new values stored and the old ones in force."""
    plan, fit, held, truth = started(autopilot, kind, before)
    rng, module, heat = np.random.default_rng(7), MODULES[autopilot], HEAT.get(kind, 32.0)
    stored = held | {c.name: c.new for c in plan.changes}
    earlier = standing(rng, held, module, truth, 0.0, heat)
    later = standing(rng, held, module, truth, 9.0, heat)
    result = verify(plan, [fit], earlier, later, parameters=stored)
    assert result.must_go
    assert "empty" not in result.must_go


IMPOSSIBLE = {
    ("ardupilot", "warm", "INS_TCAL1_TMAX"),  # the new TMIN beside the TMAX of a hidden group
    ("ardupilot", "cold", "INS_TCAL1_TMIN"),  # the new TMAX beside a TMIN of 0
    ("ardupilot", "accel", "INS_ACCSCAL_X"),  # a scale of zero marks an absent sensor
    ("ardupilot", "accel", "INS_ACCSCAL_Y"),
    ("ardupilot", "accel", "INS_ACCSCAL_Z"),
    ("px4", "cold", "TC_G0_TMIN"),
}
"""Parameters whose old value, alone beside the new ones, is no correction at all. PX4 takes no scale of zero."""


@pytest.mark.long
def test_every_parameter_whose_old_value_fits_beside_no_new_one_is_known(started):
    found = set()
    for autopilot, kind, before in STARTS:
        plan, _, held, truth = started(autopilot, kind, before)
        force = force_of(autopilot, held, plan.changes)
        every = frozenset(c.name for c in plan.changes)
        for sensor in truth:
            about = Subject(sensor, 0)
            assert force.possible(about, every) is not None
            for hypothesis in combinations_of(tuple(every)):
                force.possible(about, every - hypothesis)
            found |= {(autopilot, kind, name) for name in every if force.possible(about, every - {name}) is None}
    assert found == IMPOSSIBLE


def test_a_drive_that_is_not_streamed_leaves_a_motor_gain_open(started, make_fit):
    plan, fit, held, truth = started("ardupilot", "mag", {"COMPASS_MOTCT": 2, "COMPASS_MOT_X": 3.0})
    rng = np.random.default_rng(3)
    stored = held | {c.name: c.new for c in plan.changes}
    now = standing(rng, stored, ardupilot, truth, 9.0, 32.0)
    result = verify(plan, [fit], None, now, parameters=stored)
    assert result.must_go == ""
    assert {p.verdict for p in result.parameters} == {ProofVerdict.NOT_OBSERVABLE}
    assert "BATTERY_STATUS" in result.parameters[0].text


@pytest.mark.sampled
@pytest.mark.parametrize("kind", TRUTH)
@pytest.mark.parametrize("autopilot", MODULES)
def test_on_a_simulated_vehicle_that_never_booted_before(autopilot, kind, started):
    """Its table is another reading of the firmwares' defaults; PX4's rows have no id, so they are given."""
    vehicle = make_vehicle(load_config({"autopilot": autopilot, "factory": True, "imu_count": 1, "mag_count": 1}))
    table = {p.name: p.value for p in vehicle.table}
    if autopilot == "ardupilot":
        assert (table["INS_TCAL1_TMIN"], table["INS_TCAL1_TMAX"], table["INS_ACC1_CALTEMP"]) == (0.0, 0.0, -300.0)
    else:
        assert (table["CAL_ACC0_ID"], table["CAL_GYRO0_ID"], table["CAL_MAG0_ID"]) == (0, 0, 0)
        assert (table["CAL_ACC0_PRIO"], table["TC_G0_TMAX"], table["TC_G0_TREF"]) == (-1, 100.0, 25.0)
    plan, fit, held, truth = started(autopilot, kind, table)
    rng, module, heat = np.random.default_rng(11), MODULES[autopilot], HEAT.get(kind, 32.0)
    stored = held | {c.name: c.new for c in plan.changes}
    streams = [standing(rng, v, module, truth, t, heat) for v, t in ((held, 0.0), (stored, 9.0), (held, 18.0))]
    if autopilot == "px4" and kind == "mag":
        streams = [s.with_channels(c for c in s.channels if c.sensor != Sensor.MAG) for s in streams]
    before, after, unchanged = streams
    result = verify(plan, [fit], before, after, parameters=stored)
    assert result.must_go == ""
    if (autopilot, kind) != ("px4", "mag"):
        assert any(p.verdict == ProofVerdict.PROVED for p in result.parameters)
        assert verify(plan, [fit], before, unchanged, parameters=stored).must_go
