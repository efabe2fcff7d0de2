"""The simulated sensors against real firmware whose simulator had known errors: pose by pose, through every formula.

The simulated vehicle gets the errors that were injected into the real one and is held in the same attitudes; the means
of the streams over each pose are compared. Rule: every component within 4 sd of the mean's noise plus 1 LSB. Truncation
shifts a mean by up to half an LSB on either side, depending on the noise.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.rotation import matrices_from_quaternions, quaternion_from_euler
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Packer, split_datagram
from tests.link.replay import heard, read_frames

pytestmark = pytest.mark.shared

ZERO = np.zeros((3, 3)).tolist()
ROWS = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag")


def means(messages: list[object]) -> np.ndarray:
    return np.mean([[getattr(m, name) for name in ROWS] for m in messages], axis=0)


def streamed(vehicle: FlightController, message_id: int, euler_deg: list[float], seconds: float) -> np.ndarray:
    """Mean of one stream while a pose is held."""
    sent: list[bytes] = []
    vehicle.channels[0].transmit = sent.append
    vehicle.world.motion.hold(vehicle.time, euler_deg, transition_s=0.0)
    vehicle.advance(vehicle.time + 0.3)
    sent.clear()
    vehicle.advance(vehicle.time + seconds)
    messages = [r.message for f in sent for r in split_datagram(f)]
    return means([m for m in messages if m.get_msgId() == message_id])


def started(config: dict[str, object], parameters: dict[str, float], message_id: int) -> FlightController:
    vehicle = make_vehicle(load_config({"calibration": "none"} | config))
    vehicle.preset_parameters(parameters)
    vehicle.channels.append(MavlinkChannel(Packer(1), lambda _: None))
    vehicle.start()
    vehicle.messages.set_interval(vehicle.channels[0], message_id, 20000)  # type: ignore[attr-defined]
    return vehicle


def test_px4_bench_faces(shared_data: Path) -> None:
    """M1 of the recording's README: sensor = K·true + b, in m/s², rad/s and Gauss."""
    folder = shared_data / "px4_captures"
    frames = list(read_frames(folder / "bench_faces.tlog"))
    actions = [
        (t, [float(v) for v in what.split()[1:]])
        for t, what in json.loads((folder / "bench_faces.json").read_text())["actions"]
        if what.startswith("pose")
    ]
    scaled = [(h.t, h.received.message) for h in heard(frames, 1, {26})]
    ends = [t for t, _ in actions[1:]] + [scaled[-1][0]]
    real = [
        (pose, means([m for t, m in scaled if begin + 3.5 < t < end - 0.3]))
        for (begin, pose), end in zip(actions, ends, strict=True)
        if end - begin > 4.5
    ]
    mag_matrix = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    mag_offset = np.array([9.0, -5.5, 3.5])
    level = next(mean for pose, mean in real if pose == [0.0, 0.0, 0.0])
    field = np.linalg.solve(mag_matrix, (level[6:] + 0.5 * np.sign(level[6:])) / 10 - mag_offset)
    vehicle = started(
        {
            "autopilot": "px4",
            "imu_count": 1,
            "mag_count": 1,
            "field_ned_ut": field.tolist(),
            "accel_noise": 0.02,
            "gyro_noise": 0.002,
            "mag_noise": 0.2,
            "truth": {
                "accels": {"offset": [0.31, -0.22, 0.17], "matrix": np.diag([1.021, 0.984, 1.013]).tolist()}
                | {"polynomial": ZERO},
                "gyros": {"offset": [0.0132, -0.0284, 0.0057], "matrix": np.eye(3).tolist(), "polynomial": ZERO},
                "mags": {"offset": mag_offset.tolist(), "matrix": mag_matrix.tolist()},
            },
        },
        {"IMU_GYRO_CAL_EN": 0},
        26,
    )
    assert len(real) >= 8
    noise = np.repeat([0.02 / 9.80665e-3, 2.0, 2.0], 3)
    for pose, expected in real:
        seen = streamed(vehicle, 26, pose, 4.0)
        tolerance = 4 * noise * np.sqrt(2 / 150) + 1.0
        assert (np.abs(seen - expected) < tolerance).all(), (pose, seen - expected)


def still_poses(messages: list[tuple[float, object]]) -> list[tuple[float, float, list[float]]]:
    """Begin, end and Euler angles (deg) of the parts of SIMSTATE that stand still for more than two seconds."""
    t = np.array([when for when, _ in messages])
    rate = np.array([[m.xgyro, m.ygyro, m.zgyro] for _, m in messages])
    euler = np.degrees([[m.roll, m.pitch, m.yaw] for _, m in messages])
    still = np.linalg.norm(rate, axis=1) < 1e-4
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    spans = [(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True) if t[b - 1] - t[a] > 2.0]
    return [(t[a] + 0.4, t[b] - 0.2, euler[(a + b) // 2].tolist()) for a, b in spans]


def test_ardupilot_six_faces(shared_data: Path) -> None:
    """Raw accel = true ⊘ SCAL + b, gyro + b, compass = matrix⁻¹·field − offset; the firmware's calibration in force."""
    frames = list(read_frames(shared_data / "sitl_captures" / "six_faces.tlog"))
    truth = [(h.t, h.received.message) for h in heard(frames, 1, {164}) if h.t > 8]
    raw = [(h.t, h.received.message) for h in heard(frames, 1, {27})]
    table = {h.received.message.param_id: h.received.message.param_value for h in heard(frames, 1, {22})}
    poses = still_poses(truth)
    assert len(poses) >= 8
    correction = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    scale = 1 / np.array([1.021, 0.984, 1.013])
    yaw = np.radians(-7.0)
    field = matrices_from_quaternions(quaternion_from_euler(0, 0, float(yaw))) @ [22.40155, 8.0639, -52.89117]
    names = [
        f"{base}_{axis}" for base in ("INS_ACCOFFS", "INS_ACCSCAL", "INS_GYROFFS", "COMPASS_OFS") for axis in "XYZ"
    ]
    vehicle = started(
        {
            "imu_count": 1,
            "mag_count": 1,
            "field_ned_ut": field.tolist(),
            "accel_noise": 0.0009,
            "gyro_noise": 4e-5,
            "mag_noise": 1e-4,
            "truth": {
                "accels": {
                    "offset": [0.31, -0.22, 0.17],
                    "matrix": np.diag(scale).tolist(),
                }
                | {"polynomial": ZERO},
                "gyros": {"offset": [0.0132, -0.0084, 0.0057], "matrix": np.eye(3).tolist(), "polynomial": ZERO},
                "mags": {"offset": [-9.0, 5.5, -3.5], "matrix": np.linalg.inv(correction).tolist()},
            },
        },
        {name: table[name] for name in names} | {"INS_GYR_CAL": 0.0, "COMPASS_SCALE": 1.0},
        27,
    )
    for begin, end, euler in poses:
        expected = means([m for t, m in raw if begin < t < end])
        seen = streamed(vehicle, 27, euler, 2.0)
        assert (np.abs(seen - expected) < 1.2).all(), (euler, seen - expected)
