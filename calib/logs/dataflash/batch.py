"""Batches of a DataFlash log: some thousand consecutive samples of one sensor at its own rate (ISBH, ISBD).

ISBH says sensor, instance, when the first sample was read, rate and scale; the ISBD that follow hold 32 samples each as
int16 (``BatchSampler.cpp``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel, Rounding, Sensor, Stage

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.tables import Log

Array = NDArray[np.float64]

SAMPLES: Final = 32
SENSORS: Final = {0: (Sensor.ACCEL, "m/s2"), 1: (Sensor.GYRO, "rad/s")}
UNITS: Final = 5
"""Inertial units that a vehicle may have."""
OPTION: Final = "INS_LOG_BAT_OPT"
SENSOR_RATE, POST_FILTER = 1, 2
HEADER: Final = ("N", "type", "instance", "mul", "smp_cnt", "SampleUS", "smp_rate")
DATA: Final = ("N", "seqno", "x", "y", "z")


def batch_channels(log: Log, parameters: Mapping[str, float]) -> list[Channel]:
    """One channel for each sensor that was sampled in batches; between the batches it has gaps."""
    heads, data = log.get("ISBH"), log.get("ISBD")
    if heads is None or data is None or not all(c in heads for c in HEADER) or not all(c in data for c in DATA):
        return []
    head = dict(zip(HEADER, heads.columns(*HEADER), strict=True))
    number, sequence, x, y, z = data.columns(*DATA)
    of = np.searchsorted(heads.offsets, data.offsets) - 1
    intact = (of >= 0) & (head["N"][of] == number) & (head["mul"][of] > 0) & (head["smp_rate"][of] > 0)
    option = int(parameters.get(OPTION, 0))
    stage = Stage.RAW if option & SENSOR_RATE else Stage.FILTERED if option & POST_FILTER else Stage.CORRECTED
    found = []
    for kind, (sensor, unit) in SENSORS.items():
        for instance in range(UNITS):
            rows = np.flatnonzero(intact & (head["type"][of] == kind) & (head["instance"][of] == instance))
            if not len(rows):
                continue
            chosen = {name: column[of[rows]].astype(np.float64) for name, column in head.items()}
            counts = np.stack([axis[rows] for axis in (x, y, z)], axis=2).astype(np.float64)
            channel = _channel(
                sensor,
                instance,
                unit,
                stage=stage,
                head=chosen,
                sequence=sequence[rows].astype(np.float64),
                counts=counts,
            )
            if len(channel):
                found.append(channel)
    return found


def _channel(
    sensor: Sensor,
    instance: int,
    unit: str,
    *,
    stage: Stage,
    head: Mapping[str, Array],
    sequence: Array,
    counts: Array,
) -> Channel:
    """`head` and `sequence` (M,) of the messages, their int16 in `counts` (M, 32, 3)."""
    place = sequence[:, None] * SAMPLES + np.arange(SAMPLES)
    t = (1e-6 * head["SampleUS"][:, None] + place / head["smp_rate"][:, None]).ravel()
    inside = (place < head["smp_cnt"][:, None]).ravel()
    zero = counts == 0
    values = ((counts + 0.5 * np.sign(counts)) / head["mul"][:, None, None]).reshape(-1, 3)
    order = np.flatnonzero(inside)[np.argsort(t[inside], kind="stable")]
    quantum = float(1.0 / np.min(head["mul"]))
    return Channel(
        sensor,
        instance,
        t[order],
        values[order],
        unit,
        stage,
        "ISBD",
        quantum,
        Rounding.TOWARD_ZERO,
        zero.reshape(-1, 3)[order],
    )
