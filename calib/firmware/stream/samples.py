"""Rows of one inertial message to channels: bins to their middles, absent sensors and repeats left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.stream.messages import HIGHRES_IMU, InertialMessage, MessageSensor
from mavcal.calib.recording import Channel, Rounding, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFECT_GAUSS: Final = 10.0
"""No field is that strong; ArduPilot before PR #32286 sends HIGHRES_IMU's in mGauss times 1000."""
DEFECT_FACTOR: Final = 1e-6
REPEAT_PERIODS: Final = 1.25
"""An unchanged field counts as a new reading after so many read periods. Fewer would take repeats for samples where
reads and sends jitter. More would lose samples of a sensor that is quieter than its quantum."""


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
        columns = {reading.sensor: _columns(rows, reading) for reading in self.message.readings}
        present = _present(columns)
        channels = []
        for reading in self.message.readings:
            updated = (rows["fields_updated"] & reading.bits) == reading.bits if reading.bits else True
            values = columns[reading.sensor]
            if reading.sensor == Sensor.MAG:
                keep = self._fresh(t, values, in_order & updated & present[Sensor.MAG])
                channels.append(self._channel(reading, compass, t, values, keep))
                continue
            keep = new & updated & present[reading.sensor]
            if not self.message.by_id:
                channels.append(self._channel(reading, self.message.instance, t, values, keep))
                continue
            for unit in np.unique(rows["id"][keep]).tolist():
                channels.append(self._channel(reading, unit, t, values, keep & (rows["id"] == unit)))
        return [channel for channel in channels if len(channel)]

    def _fresh(self, t: Array, fields: NDArray[Any], candidates: Mask) -> Mask:
        """Rows with a field that holds a new reading: it differs from the one before, or its time has come."""
        keep = np.zeros(len(t), dtype=bool)
        where = np.flatnonzero(candidates)
        if not len(where):
            return keep
        values, times = fields[where], t[where]
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

    def _channel(self, reading: MessageSensor, instance: int, t: Array, values: NDArray[Any], keep: Mask) -> Channel:
        raw = values[keep].astype(np.float64)
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


def _present(columns: dict[Sensor, NDArray[Any]]) -> dict[Sensor, Mask]:
    """Where the sensors are there: an accelerometer never reads three zeros, a good gyroscope at rest may."""
    present: dict[Sensor, Mask] = {sensor: np.asarray(values.any(axis=1)) for sensor, values in columns.items()}
    present[Sensor.GYRO] |= present[Sensor.ACCEL]
    if Sensor.TEMPERATURE in present:
        # 0 says "none": PX4 sends 1 for a true 0 degC; ArduPilot then sends 0, and the next sample tells
        present[Sensor.TEMPERATURE] &= present[Sensor.ACCEL]
    return present


def _columns(rows: NDArray[Any], reading: MessageSensor) -> NDArray[Any]:
    columns = np.empty((len(rows), len(reading.fields)), rows.dtype[reading.fields[0]])
    for i, name in enumerate(reading.fields):
        columns[:, i] = rows[name]
    return columns
