"""The whole truth of a simulated vehicle as JSON: for tests and demonstrations that judge a calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from mavcal.service.simvehicle.mounting import true_angles, true_mounting
from mavcal.service.simvehicle.truth import T_REF, SensorTruth
from mavcal.service.simvehicle.vehicle import FlightController
from mavcal.service.simvehicle.world import SimWorld


def truth_report(vehicle: FlightController, since: float | None = None, until: float | None = None) -> dict[str, Any]:
    """Sensor truth by instance: raw = matrix · true + offset + polynomial(T − t_ref) + noise.

    A bias wanders. The inertial sensors' `offset` is that of this moment, or its mean from `since` to `until` (vehicle
    seconds of this boot). That mean is what samples taken then have in them. Accelerometer m/s², gyroscope rad/s,
    magnetometer µT, each in its sensor's frame. Magnetometers also carry `body_offset` and `body_matrix`, the same
    truth for the field in the body frame: raw_body = R · raw.
    """
    world, config = vehicle.world, vehicle.config
    ids = vehicle.device_ids()
    last = vehicle.time if until is None else until
    first = last if since is None else since
    t = np.linspace(first, last, 2 + int(max(last - first, 0.0)))
    return {
        "autopilot": str(config.autopilot),
        "seed": config.seed,
        "t_ref": T_REF,
        "gravity": config.gravity,
        "field_ned_ut": list(config.field_ned_ut),
        "latitude_deg": config.latitude_deg,
        "longitude_deg": config.longitude_deg,
        "altitude_m": config.altitude_m,
        "board_orientation": config.board_orientation,
        "temperature_offsets": list(config.imu_temperature_offsets[: config.imu_count]),
        "accels": [_inertial_entry(vehicle, "accels", k, ids["accel"][k], t) for k in range(config.imu_count)],
        "gyros": [_inertial_entry(vehicle, "gyros", k, ids["gyro"][k], t) for k in range(config.imu_count)],
        "mags": [_mag_entry(world, k, ids["mag"][k]) for k in range(len(world.truth.mags))],
    }


def _inertial_entry(
    vehicle: FlightController, kind: str, k: int, device_id: int, t: np.ndarray[Any, Any]
) -> dict[str, Any]:
    sensor: SensorTruth = getattr(vehicle.world.truth, kind)[k]
    offset = vehicle.world.bias(kind, k, t).mean(axis=0)
    return {"id": device_id, **sensor.as_dict(), "offset": offset.tolist()}


def _mag_entry(world: SimWorld, k: int, device_id: int) -> dict[str, Any]:
    sensor = world.truth.mags[k]
    rotation = true_mounting(world.config, k)
    return {
        "id": device_id,
        "orientation": world.config.mag_orientations[k],
        "angles_deg": true_angles(world.config, k),
        "external": world.config.mag_external[k],
        "body_offset": (rotation @ sensor.offset).tolist(),
        "body_matrix": (rotation @ sensor.matrix @ rotation.T).tolist(),
        "body_motor": (rotation @ sensor.motor).tolist(),
        "correction": np.linalg.inv(sensor.matrix).tolist(),
        **sensor.as_dict(),
    }
