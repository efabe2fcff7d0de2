"""Nothing that a plan or its proof rests on is missing from the parameters that a job reads by name."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.geometry import quaternion_from_euler
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial

from .test_needed import IDS, held, read

INERTIAL = (Sensor.ACCEL, Sensor.GYRO)
AT_REST = {
    Sensor.ACCEL: ((0.0, 0.0, -STANDARD_GRAVITY), 0.003, "m/s2"),
    Sensor.GYRO: ((0.0, 0.0, 0.0), 2e-4, "rad/s"),
    Sensor.MAG: ((21.0, 2.0, 43.0), 0.05, "uT"),
}
CURVE = ThermalPolynomial(35.0, 10.0, 55.0, np.full((3, 3), 1e-5))
LEVEL = {"roll": 0.03, "pitch": -0.04, "roll_sd": 2e-4, "pitch_sd": 2e-4}
FITS = {
    "gyro": (Sensor.GYRO, {"offset": (0.011, -0.007, 0.004)}),
    "accel": (Sensor.ACCEL, {"offset": (0.31, -0.2, 0.12), "matrix": np.diag((1.01, 0.99, 1.02)), "matrix_sd": 1e-4}),
    "mag": (Sensor.MAG, {"offset": (12.0, -8.0, 5.0), "matrix": np.diag((1.05, 0.97, 1.01)), "matrix_sd": 1e-3}),
    "thermal": (Sensor.GYRO, {"offset": (0.011, -0.007, 0.004), "polynomial": CURVE, "polynomial_sd": 1e-7}),
    "level": (
        Sensor.ACCEL,
        {"method": "level", "native": {"roll": 0.03, "pitch": -0.04, "roll_sd": 2e-4, "pitch_sd": 2e-4}},
    ),
}


def streamed(values: dict[str, Value], autopilot: str, sensors: set[Sensor], start: float) -> Recording:
    """Four seconds of every instance at rest, with the attitude."""
    rng = np.random.default_rng(int(start))
    t = start + np.arange(200) / 50.0
    channels = []
    for sensor, instance in IDS[autopilot](values):
        if sensor in sensors:
            vector, noise, unit = AT_REST[sensor]
            read_as = np.array(vector) + rng.normal(0.0, noise, (len(t), 3))
            channels.append(Channel(sensor, instance, t, read_as, unit, Stage.FILTERED, "TEST"))
            warm = np.full(len(t), 32.0)
            channels.append(Channel(Sensor.TEMPERATURE, instance, t, warm, "degC", Stage.RAW, "TEST"))
    turned = quaternion_from_euler(np.full(len(t), 0.01), np.full(len(t), -0.02), np.full(len(t), 0.7))
    channels.append(Channel(Sensor.ATTITUDE, 0, t, turned, "1", Stage.RAW, "ATTITUDE"))
    kept = {(c.sensor, c.instance): c for c in channels}  # a unit has one temperature, whichever sensor told it
    return Recording(tuple(kept.values()))


@pytest.mark.sampled
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("kind", FITS)
def test_plan_and_proof_are_those_of_the_whole_list(autopilot: str, kind: str, make_fit) -> None:
    sensor, about = FITS[kind]
    values = held(autopilot)
    sensors = {sensor, *INERTIAL}
    known = read(autopilot, values, *sensors, drift=kind == "thermal")
    assert len(known) < 0.7 * len(values)
    fits = [make_fit(s, instance, **about) for s, instance in IDS[autopilot](values) if s == sensor]
    identity = Identity(autopilot, 2, (4, 7, 0), "00112233", 1, 1)
    plans = []
    for parameters in (values, known):
        options = compose_options({}, accel_temperature=dict.fromkeys(range(3), 32.0))
        plans.append(compose(fits, parameters, fingerprint(identity, parameters), options=options))
    whole, part = plans
    assert whole.changes or whole.blockers
    assert dataclasses.replace(whole, fingerprint=part.fingerprint, snapshot_sha256=part.snapshot_sha256) == part
    of_job = [entry for entry in whole.fingerprint.device_ids if not entry[0].startswith("mag") or sensor is Sensor.MAG]
    assert of_job == list(part.fingerprint.device_ids)
    stored = {change.name: change.new for change in whole.changes}
    before, after = (streamed(values, autopilot, sensors, start) for start in (0.0, 10.0))
    told = [verify(whole, fits, before, after, parameters={**p, **stored}) for p in (values, known)]
    assert told[0] == told[1]
    assert told[0].parameters or whole.blockers
