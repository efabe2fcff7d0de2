"""Requests on the control channel of a simulated vehicle: what moves or disturbs it, and its state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from mavcal.service.simvehicle.errors import ControlError
from mavcal.service.simvehicle.faults import Injector, finite
from mavcal.service.simvehicle.mounting import true_angles, true_mounting
from mavcal.service.simvehicle.rotation import Array, matrices_from_quaternions, quaternion_from_vector
from mavcal.service.simvehicle.scripts import SCRIPTS
from mavcal.service.simvehicle.sensor_faults import SENSORS
from mavcal.service.simvehicle.truth import T_REF, SensorTruth
from mavcal.service.simvehicle.vehicle import FlightController
from mavcal.service.simvehicle.world import SimWorld

Request = Mapping[str, Any]
Reply = dict[str, Any]

DEFAULT_TILT_DEG = 3.0
DEFAULT_TREMOR_DEG = 0.2


class Process(Protocol):
    """Process that runs the vehicle, as far as the verbs need it."""

    vehicle: Any
    """The vehicle; its personality has more than every vehicle has."""

    injector: Injector
    """Its faults."""

    speed: float
    """Seconds of the vehicle's time in one of the wall clock."""

    lag_s: float
    """Delay of the last tick, s of the wall clock."""

    def set_speed(self, value: float) -> None:
        """Go at another speed. Raises ControlError if it is none."""

    def run_script(self, name: str) -> None:
        """Begin the movements of that name. Raises ControlError if there are none."""

    def stop_script(self) -> None:
        """End the movements."""

    def stop(self) -> None:
        """End the process."""


class Verbs:
    """The handler of the control channel."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._verbs: dict[str, Callable[[Request], Reply]] = {
            "hold": self._hold,
            "still": self._still,
            "tumble": self._tumble,
            "turn": self._turn,
            "jolt": self._jolt,
            "warm_up": self._warm_up,
            "temperature": self._temperature,
            "throttle": self._throttle,
            "current": self._current,
            "add": self._add,
            "bend": self._bend,
            "shake": self._shake,
            "arm": lambda _: self._arm(armed=True),
            "disarm": lambda _: self._arm(armed=False),
            "reboot": self._reboot,
            "fault": self._fault,
            "clear_faults": self._clear_faults,
            "script": self._script,
            "truth": self._truth,
            "parameters": self._parameters,
            "state": self._state,
            "speed": self._speed,
            "shutdown": self._shutdown,
        }

    @property
    def _vehicle(self) -> Any:
        return self._process.vehicle

    def __call__(self, do: str, request: Request) -> Reply:
        """Carry out one request. Raises ControlError for a verb or an entry that is not known."""
        verb = self._verbs.get(do)
        if verb is None:
            raise ControlError(f"unknown verb {do!r}; known: {', '.join(self._verbs)}")
        return verb(request)

    # --- motion

    def _hold(self, r: Request) -> Reply:
        self._process.stop_script()
        tilt = _number(r, "tilt_deg", DEFAULT_TILT_DEG)
        tremor = _number(r, "tremor_deg", DEFAULT_TREMOR_DEG)
        transition = _number(r, "transition_s", 1.5)
        pose = r.get("pose", "level")
        reached = self._vehicle.world.motion.hold(self._vehicle.time, pose, tilt, tremor, transition)
        return {"reached": reached}

    def _still(self, _r: Request) -> Reply:
        self._process.stop_script()
        self._vehicle.world.motion.still(self._vehicle.time)
        return {}

    def _tumble(self, r: Request) -> Reply:
        self._process.stop_script()
        self._vehicle.world.motion.tumble(self._vehicle.time, _number(r, "rate_dps", 45.0))
        return {}

    def _turn(self, r: Request) -> Reply:
        self._process.stop_script()
        turns = None if r.get("turns") is None else _number(r, "turns")
        axis, rate_dps = r.get("axis", [0, 0, 1]), _number(r, "rate_dps", 20.0)
        self._vehicle.world.motion.turn(self._vehicle.time, axis, rate_dps, turns)
        return {}

    def _jolt(self, r: Request) -> Reply:
        self._vehicle.world.motion.jolt(
            self._vehicle.time, r.get("peak", [3.0, 0.0, 0.0]), _number(r, "duration_s", 0.1)
        )
        return {}

    # --- surroundings

    def _warm_up(self, r: Request) -> Reply:
        start, end = _number(r, "start", 20.0), _number(r, "end", 60.0)
        self._vehicle.world.thermal.warm_up(self._vehicle.time, start, end, _number(r, "tau_s", 60.0))
        return {}

    def _temperature(self, r: Request) -> Reply:
        self._vehicle.world.thermal.hold(self._vehicle.time, _number(r, "value"))
        return {}

    def _throttle(self, r: Request) -> Reply:
        self._vehicle.world.throttle.go(self._vehicle.time, _number(r, "value"), _number(r, "ramp_s", 0.0))
        return {}

    def _current(self, r: Request) -> Reply:
        self._vehicle.world.current.go(self._vehicle.time, _number(r, "amps"), _number(r, "ramp_s", 0.0))
        return {}

    def _add(self, r: Request) -> Reply:
        sensor, instance = r.get("sensor"), int(_number(r, "instance", 0.0))
        if sensor not in SENSORS:
            raise ControlError(f"unknown sensor {sensor!r}; known: {', '.join(SENSORS)}")
        self._vehicle.world.added[f"{sensor}s", instance] = _vector(r, "by")
        return {}

    def _bend(self, r: Request) -> Reply:
        axis, angle = _vector(r, "axis"), math.radians(_number(r, "deg", 30.0))
        turn = matrices_from_quaternions(quaternion_from_vector(angle * axis / np.linalg.norm(axis)))
        self._vehicle.world.bends[int(_number(r, "instance", 0.0))] = turn
        return {}

    def _shake(self, r: Request) -> Reply:
        shaking = self._vehicle.world.shaking
        shaking.level, shaking.clips = _number(r, "level", shaking.level), int(_number(r, "clips", shaking.clips))
        return {}

    def _arm(self, *, armed: bool) -> Reply:
        self._vehicle.armed = armed
        self._vehicle.broadcast(self._vehicle.heartbeat())
        return {"armed": armed}

    def _reboot(self, r: Request) -> Reply:
        self._vehicle.reboot(flush=bool(r.get("flush", True)))
        return {}

    # --- faults and scripts

    def _fault(self, r: Request) -> Reply:
        return self._process.injector.arm(r)

    def _clear_faults(self, _r: Request) -> Reply:
        self._process.injector.clear()
        return {}

    def _script(self, r: Request) -> Reply:
        name = r.get("name")
        if name not in SCRIPTS:
            raise ControlError(f"unknown script {name!r}; known: {', '.join(SCRIPTS)}")
        self._process.run_script(str(name))
        return {}

    # --- knowledge

    def _parameters(self, _r: Request) -> Reply:
        vehicle = self._vehicle
        stored = {p.name: _json_value(p.value) for p in vehicle.table}
        return {"in_force": {k: _json_value(v) for k, v in vehicle.in_force().items()}, "stored": stored}

    def _truth(self, r: Request) -> Reply:
        until = _number(r, "until", self._vehicle.time)
        return {"truth": truth_report(self._vehicle, _number(r, "since", until), until)}

    def _state(self, _r: Request) -> Reply:
        vehicle = self._vehicle
        t = np.array([vehicle.time])
        q, rate = vehicle.world.motion.evaluate(t)
        count = len(vehicle.world.truth.accels)
        return {
            "time": vehicle.time,
            "elapsed": vehicle.elapsed,
            "alive": vehicle.alive,
            "boots": vehicle.boots,
            "armed": vehicle.armed,
            "motion": vehicle.world.motion.name,
            "quaternion": q[0].tolist(),
            "euler_deg": np.degrees(vehicle.euler()).tolist(),
            "rate": rate[0].tolist(),
            "temperatures": [float(vehicle.world.thermal.imu(k, t)[0]) for k in range(count)],
            "throttle": float(vehicle.world.throttle.at(t)[0]),
            "current": float(vehicle.world.current.at(t)[0]),
            "speed": self._process.speed,
            "lag_s": self._process.lag_s,
            "param_sets": vehicle.set_count,
            "param_set_list": [[when, name, _json_value(value)] for when, name, value in vehicle.sets],
            "own_writes": [[when, name, _json_value(value)] for when, name, value in vehicle.own_writes],
            "faults": self._process.injector.report(),
        }

    def _speed(self, r: Request) -> Reply:
        self._process.set_speed(_number(r, "value"))
        return {"speed": self._process.speed}

    def _shutdown(self, _r: Request) -> Reply:
        self._process.stop()
        return {}


def _number(request: Request, name: str, default: float | None = None) -> float:
    return finite(name, request.get(name, default))


def _vector(request: Request, name: str) -> Array:
    value = request.get(name)
    if not isinstance(value, list) or len(value) != 3:
        raise ControlError(f"{name} must be three numbers, got {value!r}")
    return np.array([_number({name: number}, name) for number in value])


def _json_value(value: float) -> float | str:
    """NaN and infinity have no JSON of their own: they go as text."""
    return value if math.isfinite(value) else str(value)


def truth_report(vehicle: FlightController, since: float | None = None, until: float | None = None) -> dict[str, Any]:
    """Sensor truth by instance: raw = matrix · true + offset + polynomial(T − t_ref) + noise.

    A bias wanders. The inertial sensors' `offset` is that of this moment, or its mean from `since` to `until` (vehicle
    seconds of this boot). That mean is what samples taken then have in them. Accelerometer m/s², gyroscope rad/s,
    magnetometer µT, each in its sensor's frame. Magnetometers also carry `body_offset` and `body_matrix`, the same
    truth for the field in the body frame: raw_body = R · raw.
    """
    world, config = vehicle.world, vehicle.config
    ids = vehicle.device_ids
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
