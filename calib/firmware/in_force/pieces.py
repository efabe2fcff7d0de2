"""Spans of a recording over which the parameters stay as they are, and the correction in force in each."""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.names import PX4_SLOTS
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel

Key = tuple[Sensor, int]
Parameters = dict[str, Value]

PX4_KEYS = tuple((sensor, instance) for sensor in CALIBRATED for instance in range(PX4_SLOTS))


_WORDS = {Sensor.ACCEL: ("ACC", "TC_A"), Sensor.GYRO: ("GYR", "TC_G"), Sensor.MAG: ("COMPASS", "MAG", "TC_M")}
"""By these a parameter's name tells whose calibration it is; one that has none of them is everybody's."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Parameters from time `start` (s) on, and on PX4 what of them has reached its memory."""

    start: float
    parameters: Parameters
    memory: dict[Key, px4.Px4Calibration]
    changes: frozenset[str] = frozenset()
    """The parameters that changed at its start."""
    _models: dict[Key, TriadModel] = field(default_factory=dict, repr=False)

    def concerns(self, sensor: Sensor) -> bool:
        """Whether a parameter that changed at its start may be of a sensor of that kind."""
        return any(_may_concern(name, sensor) for name in self.changes)

    def completed(self, autopilot: str, first: Parameters) -> Piece:
        """The same span with parameters that had not been seen before; they held all along."""
        parameters = self.parameters | first
        memory = dict(self.memory)
        if autopilot == "px4":
            for key in PX4_KEYS:
                if key not in memory:
                    loaded = _loaded(parameters, key)
                    if loaded is not None:
                        memory[key] = loaded
        return Piece(self.start, parameters, memory, self.changes)

    def changed(self, t: float, changes: Parameters) -> Piece:
        """The span that begins when `changes` are made at time `t`."""
        parameters = self.parameters | changes
        memory = {}
        for key, held in self.memory.items():
            with contextlib.suppress(FirmwareError):  # the sensor moved to a row that was never seen
                memory[key] = held.update(parameters)
        return Piece(t, parameters, memory, frozenset(changes))

    def throughout(self) -> Piece:
        """The same without a beginning."""
        return dataclasses.replace(self, start=-np.inf)

    def model(self, autopilot: str, key: Key) -> TriadModel:
        """The correction of one sensor in this span.

        Raises
        ------
        FirmwareError, InvalidInputError
            If the parameters seen do not tell it.
        """
        if key not in self._models:
            if autopilot == "ardupilot":
                model = ardupilot.calibration_in_force(self.parameters, *key)
            else:
                model = px4.calibration_in_force(self.parameters, *key, self.memory.get(key))
            if model.polynomial is not None and not model.polynomial.coefficients.any():
                model = dataclasses.replace(model, polynomial=None)
            self._models[key] = model
        return self._models[key]

    def same(self, autopilot: str, other: Piece, key: Key) -> bool:
        """Whether one sensor is corrected alike in both spans."""
        try:
            ours, theirs = self.model(autopilot, key), other.model(autopilot, key)
        except FirmwareError:
            return False
        if (ours.polynomial is None) != (theirs.polynomial is None):
            return False
        if ours.polynomial is not None and theirs.polynomial is not None:
            a, b = ours.polynomial, theirs.polynomial
            if (a.t_ref, a.t_min, a.t_max) != (b.t_ref, b.t_min, b.t_max):
                return False
            if not np.array_equal(a.coefficients, b.coefficients):
                return False
        return np.array_equal(ours.offset, theirs.offset) and np.array_equal(ours.matrix, theirs.matrix)


@lru_cache(maxsize=1024)
def _may_concern(name: str, sensor: Sensor) -> bool:
    """Whether a calibration parameter is of that kind of sensor, or of no kind alone (the board's rotation)."""
    of = [kind for kind, words in _WORDS.items() if any(word in name for word in words)]
    return not of or sensor in of


def _loaded(parameters: Parameters, key: Key) -> px4.Px4Calibration | None:
    try:
        return px4.Px4Calibration.load(parameters, *key)
    except FirmwareError:
        return None
