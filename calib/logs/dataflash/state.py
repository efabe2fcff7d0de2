"""Other channels of a DataFlash log: attitude, position, currents, motors, flight data, the simulator's truth.

========  ============================================================================================================
RATE      ROut POut YOut: inputs of the mixer with feed-forward, -1..1; AOut: throttle 0..1 (loop rate with bit 0)
MOTB      LiftMax, BatVolt (filtered voltage by ``MOT_BAT_VOLT_MAX``), ThLimit (bit 17)
XKF1 XKQ  velocity, place and attitude of each core of the estimator; EKF1, NKF1 in old firmwares
RFND      height above the ground
BARO      Press, Pa, and Temp, degC, of the first barometer: AIR
========  ============================================================================================================

Source of the table: AIRFRAME 3.1 (``Copter.cpp``, ``Log.cpp``, ``LogStructure.h``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.ardupilot.log_fields import INSTANCE_COLUMNS
from mavcal.calib.firmware.ardupilot.outputs import LEAST_US, MOST_US, motor_outputs
from mavcal.calib.geometry import quaternion_from_euler
from mavcal.calib.logs.dataflash.channels import INSTANCES, instances
from mavcal.calib.recording import Array, Channel, Rounding, Sensor, Stage

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavcal.calib.logs.dataflash.clock import Clock
    from mavcal.calib.logs.dataflash.tables import Log, Table

WHOLE: Final = ("h", "H", "i", "I")
MOST: Final[Mapping[Sensor, Array]] = {
    Sensor.ATTITUDE: np.full(4, 1.0 + 1e-6),
    Sensor.POSITION: np.array([90.0, 180.0, 1e5]),
    Sensor.VELOCITY: np.full(3, 1000.0),
    Sensor.PLACE: np.full(3, 1e7),
    Sensor.CURRENT: np.array([2000.0]),
    Sensor.THROTTLE: np.array([1.1]),
    Sensor.MOTOR: np.array([1.0]),
    Sensor.ROTOR_SPEED: np.array([5000.0]),
    Sensor.VIBRATION: np.full(3, 1000.0),
    Sensor.CONTROL: np.full(4, 10.0),
    Sensor.MIXER: np.full(3, 10.0),
    Sensor.VOLTAGE: np.array([1000.0]),
    Sensor.HEIGHT: np.array([1e4]),
    Sensor.AIR: np.array([2e5, 200.0]),
}
"""Largest plausible values, in the unit of the channel; larger ones are damage."""
FIX_3D: Final = 3
"""Least ``GPS.Status`` with a position and velocity."""
_QUATERNION = ("Q1", "Q2", "Q3", "Q4")
_TRUTH = (
    ("SIM", Sensor.ATTITUDE, _QUATERNION, "1"),
    ("SIM", Sensor.POSITION, ("Lat", "Lng", "Alt"), "deg deg m"),
    ("SIM2", Sensor.PLACE, ("PN", "PE", "PD"), "m"),
    ("SIM2", Sensor.VELOCITY, ("VN", "VE", "VD"), "m/s"),
)
ESTIMATORS: Final = ("XKF1", "NKF1", "EKF1")
QUATERNIONS: Final = ("XKQ", "NKQ", "XKQ1", "NKQ1")
_ESTIMATED: Final = (
    (Sensor.VELOCITY, ("VN", "VE", "VD"), "m/s"),
    (Sensor.PLACE, ("PN", "PE", "PD"), "m"),
)


def state_channels(
    log: Log, clock: Clock, parameters: Mapping[str, float], vehicle_type: int | None = None
) -> list[Channel]:
    """Attitude, position, velocity, current, throttle, motors and rotors, as far as the log has them."""
    found: list[Channel | None] = [_attitude(log, clock)]
    for number, name in enumerate(("GPS", "GPS2")):
        if name in log:
            found += _gps(log[name], clock, number)
    found += _currents(log, clock)
    found += [
        _throttle(log, clock),
        _motors(log, clock, parameters, vehicle_type),
        _rotors(log, clock),
        *_vibration(log, clock),
    ]
    return [channel for channel in found if channel is not None and len(channel)]


def reference_channels(log: Log, clock: Clock) -> list[Channel]:
    """The simulator's truth: attitude and position of SIM, place and velocity of SIM2."""
    found = []
    for name, sensor, columns, unit in _TRUTH:
        table = log.get(name)
        if table is not None and all(column in table for column in columns):
            values = np.column_stack(table.columns(*columns))
            values = unit_quaternions(values) if sensor is Sensor.ATTITUDE else values
            found.append(channel_of(sensor, table, clock.times(table), values, unit))
    return [channel for channel in found if len(channel)]


def channel_of(
    sensor: Sensor, table: Table, t: Array, values: Array, unit: str, *, instance: int = 0, quantum: float = 0.0
) -> Channel:
    """A channel of the plausible rows, in the order of time."""
    with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
        values = np.asarray(values, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        good = (np.abs(values) <= MOST[sensor]).all(axis=1) & np.isfinite(values).all(axis=1) & np.isfinite(t)
    if not good.all():
        t, values = t[good], values[good]
    if (np.diff(t) < 0).any():
        order = np.argsort(t, kind="stable")
        t, values = t[order], values[order]
    rounding = Rounding.NEAREST if quantum else Rounding.NONE
    return Channel(sensor, instance, t, values, unit, Stage.RAW, table.name, quantum, rounding)


def unit_quaternions(q: Array) -> Array:
    """The quaternions (N, 4), normalised; nan where undefined."""
    length = np.linalg.norm(q, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where((length > 0.5)[:, None], q / length[:, None], np.nan))


def _attitude(log: Log, clock: Clock) -> Channel | None:
    table = log.get("ATT")
    if table is not None and all(name in table for name in ("Roll", "Pitch", "Yaw")):
        roll, pitch, yaw = (np.radians(column) for column in table.columns("Roll", "Pitch", "Yaw"))
        return channel_of(Sensor.ATTITUDE, table, clock.times(table), quaternion_from_euler(roll, pitch, yaw), "1")
    for name in ("XKQ", "NKQ", "AHR2"):
        table = log.get(name)
        if table is not None and all(column in table for column in _QUATERNION):
            rows = table["C"] == 0 if "C" in table else slice(None)
            q = np.column_stack([column[rows] for column in table.columns(*_QUATERNION)])
            return channel_of(
                Sensor.ATTITUDE, table, clock.times(table)[rows], unit_quaternions(q.astype(np.float64)), "1"
            )
    return None


def _gps(table: Table, clock: Clock, number: int) -> list[Channel]:
    found = []
    fixed = table["Status"] >= FIX_3D if "Status" in table else np.ones(len(table), dtype=bool)
    for instance, rows in instances(table.where(fixed), number):
        t = clock.times(rows)
        if all(name in rows for name in ("Lat", "Lng", "Alt")):
            place = rows.arrays(("Lat", "Lng", "Alt"))[0]
            found.append(channel_of(Sensor.POSITION, rows, t, place, "deg deg m", instance=instance))
        if all(name in rows for name in ("Spd", "GCrs", "VZ")):
            speed, course, down = rows.arrays(("Spd", "GCrs", "VZ"))[0].T
            velocity = np.column_stack([speed * np.cos(np.radians(course)), speed * np.sin(np.radians(course)), down])
            found.append(channel_of(Sensor.VELOCITY, rows, t, velocity, "m/s", instance=instance))
    return found


def _currents(log: Log, clock: Clock) -> list[Channel]:
    found = []
    for names in (("BAT", "BAT2"), ("CURR", "CUR2")):
        for number, name in enumerate(names):
            table = log.get(name)
            if table is None or "Curr" not in table:
                continue
            quantum = 0.01 if table.format.letter("Curr") in WHOLE else 0.0  # cA in old firmwares
            for instance, rows in instances(table, number):
                current = rows["Curr"] * (quantum or 1.0)
                found.append(
                    channel_of(
                        Sensor.CURRENT, rows, clock.times(rows), current, "A", instance=instance, quantum=quantum
                    )
                )
        if found:
            break
    return found


def _throttle(log: Log, clock: Clock) -> Channel | None:
    table = log.get("CTUN")
    column = next((name for name in ("ThO", "ThrOut") if table is not None and name in table), None)
    if table is None or column is None:
        table, column = log.get("CURR"), "Throttle"
        if table is None:
            return None
        column = next((name for name in ("Throttle", "ThrOut") if name in table), "")
        if not column:
            return None
    whole = table.format.letter(column) in WHOLE
    scale = 1000.0 if whole else 100.0 if "NavRoll" in table else 1.0  # planes log per cent
    return channel_of(
        Sensor.THROTTLE, table, clock.times(table), table[column] / scale, "1", quantum=1e-3 if whole else 0.0
    )


def _motors(log: Log, clock: Clock, parameters: Mapping[str, float], vehicle_type: int | None) -> Channel | None:
    """Drive of every motor, 0..1, or -1..1 if reversible. An output that is never driven is left out."""
    table = log.get("RCOU") or log.get("MOT")
    if table is None:
        return None
    names = {int(name.strip("ChanMot")): name for name in table.names if name.strip("ChanMot").isdigit()}
    chosen = motor_outputs(list(names), parameters, vehicle_type)
    named = any(name.startswith("SERVO") and name.endswith("_FUNCTION") for name in parameters)
    drives = []
    for output in chosen:
        pulse = table[names[output.number]].astype(np.float64)
        drive = output.drive(pulse)
        presumed = not named and drive.any() and not np.ptp(drive)  # one pulse throughout is a servo's, or nobody's
        if ((pulse >= LEAST_US) & (pulse <= MOST_US)).any() and not presumed:
            drives.append(drive)
    if not drives:
        return None
    low, high = chosen[0].low, chosen[0].high
    return channel_of(Sensor.MOTOR, table, clock.times(table), np.column_stack(drives), "1", quantum=1.0 / (high - low))


def _vibration(log: Log, clock: Clock) -> list[Channel]:
    """VIBE levels of each inertial unit; firmwares before 4.1 have only those of the unit in use, the first one."""
    table = log.get("VIBE")
    columns = ("VibeX", "VibeY", "VibeZ")
    if table is None or any(name not in table for name in columns):
        return []
    t, levels = clock.times(table), table.arrays(columns)[0]
    unit = table["IMU"] if "IMU" in table else np.zeros(len(t), dtype=np.intp)
    return [
        channel_of(Sensor.VIBRATION, table, t[unit == number], levels[unit == number], "m/s2", instance=number)
        for number in np.unique(unit).tolist()
        if 0 <= number < INSTANCES
    ]


def _rotors(log: Log, clock: Clock) -> Channel | None:
    """Speeds of all rotors at the message times of the first; the others hold their last value."""
    table = log.get("ESC")
    if table is None or "RPM" not in table:
        return None
    rotors = []
    for _, rows in instances(table, 0):
        t, speed = clock.times(rows), rows["RPM"] / 60.0
        known = np.flatnonzero(np.isfinite(t) & np.isfinite(speed))
        order = known[np.argsort(t[known], kind="stable")]
        if len(order):
            rotors.append((t[order], speed[order]))
    if not any(
        speed.any() for _, speed in rotors
    ):  # without telemetry of the speed controllers the firmware logs zeros
        return None
    grid = rotors[0][0]
    columns = [values[np.maximum(np.searchsorted(times, grid, side="right") - 1, 0)] for times, values in rotors]
    return channel_of(Sensor.ROTOR_SPEED, table, grid, np.column_stack(columns), "Hz")


def dynamics_channels(log: Log, clock: Clock) -> tuple[Channel, ...]:
    """CONTROL, MIXER, VOLTAGE, HEIGHT, AIR, and the estimator's VELOCITY, PLACE and ATTITUDE, as far as logged."""
    found = [*_plain(log, clock), *_estimates(log, clock), *_attitudes(log, clock)]
    return tuple(channel for channel in found if len(channel))


def _plain(log: Log, clock: Clock) -> Iterator[Channel]:
    for name, sensor, columns, unit in (
        ("RATE", Sensor.CONTROL, ("ROut", "POut", "YOut", "AOut"), "1"),
        ("MOTB", Sensor.MIXER, ("LiftMax", "BatVolt", "ThLimit"), "1"),
    ):
        table = log.get(name)
        if table is not None and all(column in table for column in columns):
            yield channel_of(sensor, table, clock.times(table), table.arrays(columns)[0], unit)
    battery = log.get("BAT") or log.get("CURR")
    if battery is not None and "Volt" in battery:
        first = battery.where(_first(battery))
        scale = 0.01 if battery.format.letter("Volt") in {"h", "H"} else 1.0
        yield channel_of(Sensor.VOLTAGE, first, clock.times(first), scale * first["Volt"], "V")
    finder = log.get("RFND")
    column = None if finder is None else next((c for c in ("Dist", "Dist1") if c in finder), None)
    if finder is not None and column is not None:
        yield channel_of(Sensor.HEIGHT, finder, clock.times(finder), finder[column], "m")
    barometer = log.get("BARO")
    if barometer is not None and "Press" in barometer and "Temp" in barometer:
        first = barometer.where(_first(barometer))
        yield channel_of(Sensor.AIR, first, clock.times(first), first.arrays(("Press", "Temp"))[0], "Pa degC")


def _first(table: Table) -> NDArray[np.bool_]:
    """Mask of the rows of the first instance."""
    column = next((c for c in INSTANCE_COLUMNS if c in table), None)
    return np.ones(len(table), dtype=bool) if column is None else np.asarray(table[column] == table[column].min())


def _estimates(log: Log, clock: Clock) -> Iterator[Channel]:
    table = next((log[name] for name in ESTIMATORS if name in log), None)
    if table is None:
        return
    for core, rows in _cores(table):
        for sensor, columns, unit in _ESTIMATED:
            if all(column in rows for column in columns):
                yield channel_of(sensor, rows, clock.times(rows), rows.arrays(columns)[0], unit, instance=core)


def _attitudes(log: Log, clock: Clock) -> Iterator[Channel]:
    table = next((log[name] for name in QUATERNIONS if name in log), None)
    columns = ("Q1", "Q2", "Q3", "Q4")
    if table is None or any(column not in table for column in columns):
        return
    for core, rows in _cores(table):
        q = unit_quaternions(np.column_stack(rows.columns(*columns)).astype(np.float64))
        yield channel_of(Sensor.ATTITUDE, rows, clock.times(rows), q, "1", instance=core)


def _cores(table: Table) -> Iterator[tuple[int, Table]]:
    """The rows of each core of the estimator."""
    if "C" not in table:
        yield from instances(table, 0)
        return
    cores = table["C"]
    for core in np.unique(cores).tolist():
        yield int(core), table.where(cores == core)
