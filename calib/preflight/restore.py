"""Plans to write the last verified calibration again where parameters were lost or changed.

Nothing is estimated here. The plan is for the same unit whose calibration was verified; the service writes it like any
other plan. Afterwards the sensors must pass the limits of a preflight, since the calibration may be old.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import calibration_names
from mavcal.calib.firmware.compose.ardupilot_mark import mark_calibrated
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.px4_memory import Vector, set_vector
from mavcal.calib.firmware.names import (
    CROSS,
    LEVEL,
    MOTOR,
    OFFSET,
    PX4_CUSTOM,
    ROTATION_EULER,
    SCALE,
    THERMAL,
    Role,
    Triple,
)
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import (
    Fingerprint,
    LeftOut,
    ParameterKind,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Value,
    WritePlan,
)
from mavcal.calib.preflight.check import Measure, Verdict, VerifiedCalibration
from mavcal.calib.preflight.expected import ExpectedCalibration, ExpectedValue, expected, last_of_each
from mavcal.calib.preflight.inertial import force_measures, rest_measures
from mavcal.calib.preflight.rest import Mean, mean_at_rest, moved
from mavcal.calib.recording import Recording, Sensor

_RANKS: Mapping[Role, Rank] = {
    Role.TEMPERATURE: Rank.TEMPERATURE,
    Role.THERMAL_ENABLE: Rank.THERMAL_ENABLE,
    **dict.fromkeys((Role.THERMAL_ID, Role.THERMAL_MIN, Role.THERMAL_MAX, Role.THERMAL_REF), Rank.THERMAL),
    **dict.fromkeys((role for triple in THERMAL for role in triple), Rank.THERMAL),
    **dict.fromkeys((Role.ROTATION, Role.EXTERNAL, *ROTATION_EULER), Rank.ROTATION),
    **dict.fromkeys(OFFSET, Rank.OFFSET),
    **dict.fromkeys(CROSS, Rank.CROSS),
    **dict.fromkeys(SCALE, Rank.SCALE),
    **dict.fromkeys(MOTOR, Rank.SETTING),
    Role.FIELD_SCALE: Rank.FIELD_SCALE,
    Role.ID: Rank.ID,
}
"""Order of writing by role; other roles are settings."""
_AT_START = ("AHRS_ORIENTATION", "CUST_ROT", "SENS_BOARD_ROT", "TC_A_ENABLE", "TC_G_ENABLE")
"""Names that act with the next start of the vehicle (FLIGHT_CONTROLLERS 1.1, 1.4)."""
_HARMLESS = frozenset({Role.USE, Role.PRIORITY, Role.EXTERNAL, Role.MOTOR_TYPE, *MOTOR})
"""Roles without which the rest of a sensor's calibration still holds."""


def compose_restore(
    history: Sequence[VerifiedCalibration],
    parameters: Mapping[str, Value],
    kinds: Mapping[str, ParameterKind],
    fingerprint: Fingerprint,
    *,
    options: ComposeOptions,
) -> WritePlan:
    """Plan that restores the last verified calibration of every sensor.

    Parameters
    ----------
    history
        The verified calibrations of this vehicle, oldest first.
    parameters, kinds
        Its parameters as they are now, every one that :func:`expected_names` says, and their types on the wire.
    fingerprint
        Whose plan it is.
    options
        `only` and `mark_calibrated` count.

    Returns
    -------
    WritePlan
        Values that cannot be restored are in its warnings and in `left_out`; if that is everything, in its blockers.
        Without changes and blockers the vehicle already has everything.

    Raises
    ------
    FirmwareError
        If there is no verified calibration, or one belongs to another unit, or its unit is not known.
    """
    require_same_unit(history, fingerprint.uid)
    wanted = expected(history, fingerprint.autopilot, parameters, only=options.only)
    return _Restoration(wanted, parameters, kinds, fingerprint, options).plan()


def require_same_unit(history: Sequence[VerifiedCalibration], uid: str | None) -> None:
    """Raise FirmwareError if `history` is empty or a calibration in it is not certainly of the unit `uid`."""
    if not last_of_each(history):
        raise FirmwareError("no verified calibration of this vehicle is known here, so there is nothing to restore")
    if not uid:
        raise FirmwareError("this vehicle does not say which unit it is, and a calibration is only restored to its own")
    others = sorted({entry.uid or "a unit that is not known" for entry in history if entry.uid != uid})
    if others:
        raise FirmwareError(
            f"the verified calibration is of {', '.join(others)}, and this is {uid}: a calibration is never restored "
            "to another unit. Calibrate this one"
        )


def expected_names(
    history: Sequence[VerifiedCalibration], autopilot: str | None, parameters: Mapping[str, Value]
) -> frozenset[str]:
    """Names of the parameters that a restore would set, with the sensors located by `parameters`."""
    return frozenset(value.name for value in expected(history, autopilot, parameters).values)


class _Restoration:
    def __init__(
        self,
        wanted: ExpectedCalibration,
        parameters: Mapping[str, Value],
        kinds: Mapping[str, ParameterKind],
        fingerprint: Fingerprint,
        options: ComposeOptions,
    ) -> None:
        self._wanted, self._parameters, self._kinds = wanted, parameters, kinds
        self._fingerprint, self._options = fingerprint, options
        self._draft = Draft(parameters, options, ParameterKind.INT32)  # every integer comes with its own type
        self._reasons: list[str] = []
        asked = options.only
        self._left_out = {
            Subject(out.sensor, out.instance): out.reason
            for out in wanted.homeless
            if not asked or (out.sensor, out.instance) in asked
        }

    def plan(self) -> WritePlan:
        values = list(self._usable())
        if self._fingerprint.autopilot == "px4":
            self._vectors(values)
        for wanted in values:
            self._set(wanted)
        if self._fingerprint.autopilot == "px4":
            self._angles_in_order(values)
        accels = {w.about.instance for w in values if w.about is not None and w.about.sensor == Sensor.ACCEL}
        changed = [change for change in self._draft.changes if change.sensor == Sensor.ACCEL]
        if self._fingerprint.autopilot == "ardupilot" and changed:
            mark_calibrated(self._draft, Sensor.ACCEL, accels)
        for text in (*self._wanted.moved, *self._wanted.missing, *self._reasons):
            self._draft.warn(text)
        nothing = not values or (not self._draft.changes and bool(self._reasons))
        if nothing and not self._draft.changes:
            why = "; ".join((*self._wanted.missing, *self._reasons)) or "none of these sensors was verified"
            self._draft.block(f"nothing can be restored: {why}")
        left = sorted(self._left_out.items(), key=lambda item: (item[0].sensor, item[0].instance))
        out = [LeftOut(about.sensor, about.instance, reason) for about, reason in left]
        return self._draft.plan(self._fingerprint, left_out=out)

    def _usable(self) -> Iterator[ExpectedValue]:
        """Values with a place, without sensors that lack some of their places."""
        out = set(self._untold())
        lost: dict[Subject | None, list[str]] = {}
        for wanted in self._wanted.values:
            if wanted.name not in self._parameters:
                lost.setdefault(wanted.about, []).append(wanted.name)
                if wanted.about is not None and wanted.role not in _HARMLESS:
                    out.add(wanted.about)
        for about, absent in lost.items():
            whole = f"{about} is left out" if about in out else f"{', '.join(absent)} cannot be put back"
            why = f"the vehicle does not have {', '.join(absent[:3])} any more"
            self._reasons.append(f"{whole}: {why}")
            if about is not None:
                self._left_out.setdefault(about, why if about in out else f"{whole}: {why}")
        for wanted in self._wanted.values:
            if wanted.about not in out and wanted.name in self._parameters:
                yield wanted

    def _untold(self) -> Iterator[Subject]:
        """Sensors without distinct device ids."""
        for sensor in sorted(self._wanted.by_place):
            about = {w.about for w in self._wanted.values if w.about is not None and w.about.sensor == sensor}
            if about:
                why = (
                    "no device ids say which one is which, then or now. Restart the vehicle, so that it registers its "
                    "sensors, and try again"
                )
                self._reasons.append(f"every {sensor} is left out: {why}")
                for each in about:
                    self._left_out.setdefault(each, why)
            yield from about

    def _vectors(self, values: list[ExpectedValue]) -> None:
        """Values ordered by vector: PX4 loads a row vector by vector, and small changes of one only at a restart."""
        rows: dict[tuple[Subject, Triple], dict[Role, ExpectedValue]] = {}
        for wanted in values:
            triple = next((t for t in (OFFSET, SCALE, CROSS) if wanted.role in t), None)
            if wanted.about is not None and wanted.role is not None and triple is not None and self._in_row(wanted):
                rows.setdefault((wanted.about, triple), {})[wanted.role] = wanted
        for (about, triple), row in rows.items():
            if set(row) != set(triple):
                continue
            numbers = np.array([float(row[role].value) for role in triple])
            set_vector(self._draft, Vector(about, triple, numbers, np.zeros(3), "", _why(row[triple[0]])), numbers)
            for wanted in row.values():
                values.remove(wanted)

    def _angles_in_order(self, values: Sequence[ExpectedValue]) -> None:
        """Values with angles before rotation numbers: while a row has angles, PX4 sets the number to "custom"."""
        for number in values:
            if number.about is None or number.role != Role.ROTATION:
                continue
            angles = [w.name for w in values if w.about == number.about and w.role in ROTATION_EULER]
            last = int(number.value) != PX4_CUSTOM
            self._draft.reorder([*angles, number.name] if last else [number.name, *angles])

    def _in_row(self, wanted: ExpectedValue) -> bool:
        """Whether its row already has the id; an empty row is loaded completely when its id is written."""
        assert wanted.about is not None
        if not self._parameters.get(f"{wanted.name.rpartition('_')[0]}_ID", 0):
            return False
        roles = calibration_names("px4", self._parameters, wanted.about.sensor, wanted.about.instance)
        return wanted.name in roles.values()

    def _set(self, wanted: ExpectedValue) -> None:
        rank = _RANKS.get(wanted.role, Rank.SETTING) if wanted.role is not None else _shared_rank(wanted.name)
        kind = self._kinds[wanted.name]
        later = wanted.name.startswith(_AT_START) or (
            wanted.role == Role.THERMAL_ID and self._fingerprint.autopilot == "px4"
        )
        about, why = wanted.about, _why(wanted)
        if kind == ParameterKind.REAL32:
            self._draft.set_real(wanted.name, float(wanted.value), rank, why, about=about, needs_reboot=later)
        else:
            self._draft.set_integer(
                wanted.name, int(wanted.value), rank, why, kind=kind, about=about, needs_reboot=later
            )


def _shared_rank(name: str) -> Rank:
    if name.startswith(LEVEL):
        return Rank.LEVEL
    return Rank.ROTATION if name.startswith(_AT_START) else Rank.SETTING


def _why(wanted: ExpectedValue) -> str:
    before = "" if wanted.then == wanted.name else f", {wanted.then} then"
    of = "" if wanted.about is None else f" of {wanted.about}"
    return f"as verified by job {wanted.entry.job}{of}{before}"


# --- what the sensors read afterwards


def sensors_at_rest(plan: WritePlan, after: Recording) -> tuple[SensorCheck, ...]:
    """Whether the inertial sensors of a restored `plan` read zero and gravity, by the limits of a preflight.

    `after` is the corrected stream after the write. A sensor that was moved meanwhile is not observable.
    """
    about = sorted({(c.sensor, c.instance) for c in plan.changes if c.sensor in (Sensor.GYRO, Sensor.ACCEL)})
    gyros, accels = (_means(after, sensor) for sensor in (Sensor.GYRO, Sensor.ACCEL))
    motion = moved(gyros, accels)
    rates = rest_measures(gyros) if motion is None else {}
    forces = force_measures(accels, None) if motion is None else {}
    return tuple(_sensor_check(Sensor(s), i, (rates if s == Sensor.GYRO else forces).get(i)) for s, i in about)


def _means(recording: Recording, sensor: Sensor) -> dict[int, Mean]:
    found = {i: mean_at_rest(recording, sensor, i) for i in recording.instances(sensor)}
    return {i: mean for i, mean in found.items() if isinstance(mean, Mean)}


def _sensor_check(sensor: Sensor, instance: int, measure: Measure | None) -> SensorCheck:
    gyro = sensor == Sensor.GYRO
    id_, unit = (SensorCheckId.GYRO_ZERO, "rad/s") if gyro else (SensorCheckId.ACCEL_GRAVITY, "m/s2")
    if measure is None or measure.verdict == Verdict.UNKNOWN:
        text = f"{Subject(sensor, instance)} was not at rest"
        return SensorCheck(id_, sensor, instance, None, None, unit, None, SensorVerdict.NOT_OBSERVABLE, text)
    per = math.radians(1.0) if sensor == Sensor.GYRO else 1.0
    verdict = SensorVerdict.WRONG if measure.verdict == Verdict.FAIL else SensorVerdict.RIGHT
    limit = measure.limit + 3.0 * measure.sd
    return SensorCheck(
        id_, sensor, instance, measure.value * per, limit * per, unit, measure.sd * per, verdict, measure.text
    )
