"""Rows of one inertial message to channels: bins to their middles, absent sensors and repeats left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calib.firmware.messages import FIELDS, HIGHRES_IMU, InertialMessage, Reading
from calib.recording import Channel, Rounding, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFECT_GAUSS: Final = 10.0
"""No field is that strong; ArduPilot before PR #32286 sends HIGHRES_IMU's in mGauss times 1000."""
DEFECT_FACTOR: Final = 1e-6
REPEAT_PERIODS: Final = 1.25
"""An unchanged field counts as read anew after so many read periods; less would take repeats for samples where reads
and sends jitter, more would lose samples of a sensor that is quieter than its quantum."""


@dataclass
class MessageSamples:
    """Takes the rows of one message as they come and gives channels; what it remembers makes batches seamless."""

    message: InertialMessage
    newest: float = -np.inf
    _field: NDArray[Any] | None = field(default=None, repr=False)
    _field_t: float = -np.inf

    def feed(self, t: Array, rows: NDArray[Any], compass: int) -> list[Channel]:
        """Channels of `rows` at times `t` (in order of arrival); `compass` is the instance of the field."""
        reached = np.maximum.accumulate(np.concatenate(([self.newest], t)))
        self.newest = float(reached[-1])
        new, in_order = t > reached[:-1], t >= reached[:-1]
        present = _present(rows)
        units = rows["id"].astype(np.int64) if self.message.by_id else np.full(len(rows), self.message.instance)
        channels = []
        for reading in self.message.readings:
            updated = (rows["fields_updated"] & reading.bits) == reading.bits if reading.bits else True
            if reading.sensor == Sensor.MAG:
                keep = self._fresh(t, rows, in_order & updated)
                channels.append(self._channel(reading, compass, t, rows, keep))
                continue
            keep = new & updated & present[reading.sensor]
            for unit in np.unique(units[keep]).tolist():
                channels.append(self._channel(reading, unit, t, rows, keep & (units == unit)))
        return [channel for channel in channels if len(channel)]

    def _fresh(self, t: Array, rows: NDArray[Any], candidates: Mask) -> Mask:
        """Rows with a field that was read anew: it differs from the one before, or its time has come."""
        keep = np.zeros(len(t), dtype=bool)
        where = np.flatnonzero(candidates & _triple(rows, Sensor.MAG).any(axis=1))
        if not len(where):
            return keep
        values, times = _triple(rows, Sensor.MAG)[where], t[where]
        before = np.concatenate((values[:1] if self._field is None else self._field[None], values[:-1]))
        changed = (values != before).any(axis=1)
        changed[0] |= self._field is None
        due = REPEAT_PERIODS * self.message.read_s
        last = self._field_t
        for i, (time, differs) in enumerate(zip(times.tolist(), changed.tolist(), strict=True)):
            if differs or time - last >= due:
                keep[where[i]] = True
                last = time
        self._field, self._field_t = values[-1].copy(), last
        return keep

    def _channel(self, reading: Reading, instance: int, t: Array, rows: NDArray[Any], keep: Mask) -> Channel:
        raw = _triple(rows, reading.sensor)[keep].astype(np.float64)
        zero_bin = None
        if reading.rounding == Rounding.TOWARD_ZERO:
            zero_bin = raw == 0.0
            raw = raw + 0.5 * np.sign(raw)  # bins are (k, k + 1) for k > 0 and (-1, 1) for 0
        elif self.message.message_id == HIGHRES_IMU and reading.sensor == Sensor.MAG:
            with np.errstate(over="ignore"):
                defect = np.linalg.norm(raw, axis=1) > DEFECT_GAUSS
            raw = np.where(defect[:, None], DEFECT_FACTOR * raw, raw)
        return Channel(
            sensor=reading.sensor,
            instance=instance,
            t=t[keep],
            values=reading.factor * raw,
            unit=reading.unit,
            stage=reading.stage,
            source=self.message.name,
            quantum=reading.quantum,
            rounding=reading.rounding,
            zero_bin=zero_bin,
        )


def _present(rows: NDArray[Any]) -> dict[Sensor, Mask]:
    """Where the sensors are there: an accelerometer never reads three zeros, a good gyroscope at rest may."""
    accel = _triple(rows, Sensor.ACCEL).any(axis=1)
    gyro = accel | _triple(rows, Sensor.GYRO).any(axis=1)
    # 0 says "none": PX4 sends 1 for a true 0 degC; ArduPilot then sends 0, and the next sample tells
    return {Sensor.ACCEL: accel, Sensor.GYRO: gyro, Sensor.TEMPERATURE: accel & (rows["temperature"] != 0)}


def _triple(rows: NDArray[Any], sensor: Sensor) -> NDArray[Any]:
    return np.stack([rows[name] for name in FIELDS[sensor]], axis=1)
