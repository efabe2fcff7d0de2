"""Input and results of checks, how a value with its uncertainty is judged, and whether the vehicle would arm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import still_held
from mavcal.calib.recording import Identity, Recording, Sensor

SURE = 3.0
"""Standard deviations by which a value must exceed its limit to fail; by less, it is a warning."""


class Verdict(StrEnum):
    """What a check, or a whole report, comes to."""

    PASS = "pass"  # noqa: S105 - no password
    WARN = "warn"  # beyond the limit, but not beyond doubt; or a matter of judgement
    FAIL = "fail"
    UNKNOWN = "unknown"  # the check cannot be made; its reason says why


class CheckId(StrEnum):
    """Stable names of the checks, in the order of the report."""

    SENSORS_HEARD = "sensors_heard"
    GYRO_REST = "gyro_rest"
    GYRO_NOISE = "gyro_noise"
    ACCEL_FORCE = "accel_force"
    COMPASS_FIELD = "compass_field"
    COMPASS_DIRECTION = "compass_direction"
    ATTITUDE = "attitude"
    TEMPERATURE = "temperature"
    CALIBRATION_AGE = "calibration_age"
    SENSOR_IDS = "sensor_ids"
    PARAMETERS_CHANGED = "parameters_changed"
    MOTOR_COMPENSATION = "motor_compensation"
    VIBRATION = "vibration"
    ONBOARD_CALIBRATION = "onboard_calibration"
    ARMING_CHECKS = "arming_checks"
    VEHICLE_PREARM = "vehicle_prearm"


ASKS = {
    CheckId.SENSORS_HEARD: "Is every sensor that the parameters announce and use heard, and does none stand still?",
    CheckId.GYRO_REST: "Does every gyroscope read zero at rest?",
    CheckId.GYRO_NOISE: "Is every gyroscope as quiet as it should be at rest?",
    CheckId.ACCEL_FORCE: "Does every accelerometer read g, and the same vector as the others?",
    CheckId.COMPASS_FIELD: "Does every compass read the strength of the Earth's field?",
    CheckId.COMPASS_DIRECTION: "Do dip and heading of every compass agree with the model, the others and the vehicle?",
    CheckId.ATTITUDE: "Does the vehicle's own attitude agree with its accelerometers?",
    CheckId.TEMPERATURE: "Are the inertial units inside the temperatures that their calibration covers?",
    CheckId.CALIBRATION_AGE: "How old is the last verified calibration?",
    CheckId.SENSOR_IDS: "Are the sensors those that were calibrated?",
    CheckId.PARAMETERS_CHANGED: "Are the calibration parameters those that were verified?",
    CheckId.MOTOR_COMPENSATION: "Can the motor compensation of the compasses be right?",
    CheckId.VIBRATION: "Is the vehicle quiet, and has no accelerometer clipped since the start?",
    CheckId.ONBOARD_CALIBRATION: "Does the vehicle run no calibration of its own?",
    CheckId.ARMING_CHECKS: "Are the vehicle's own arming checks switched on?",
    CheckId.VEHICLE_PREARM: "Would the vehicle arm now, by its own checks?",
}
"""The question that each check answers."""


@dataclass(frozen=True)
class Measure:
    """One number of a check, and its limit.

    `sd` includes the noise of the capture and other uncertainty. `of` names the measured quantity. `suspects` are the
    possible causes if the number exceeds the limit: several if ambiguous.
    """

    of: str
    value: float
    sd: float
    limit: float
    unit: str
    suspects: tuple[str, ...] = ()
    witness: str = ""
    """Sentence on the evidence that identifies the suspect, or that would."""
    remedy: str = ""
    """Remedy for this measure; empty: the remedy of the check."""

    @property
    def verdict(self) -> Verdict:
        """Fail only beyond the uncertainty; a value too uncertain for a verdict is unknown."""
        if self.value - SURE * self.sd > self.limit:
            return Verdict.FAIL
        if SURE * self.sd > self.limit:
            return Verdict.UNKNOWN
        return Verdict.WARN if self.value > self.limit else Verdict.PASS

    @property
    def text(self) -> str:
        """The number as a line of evidence."""
        return f"{self.of}: {self.value:.3g} ± {self.sd:.2g} {self.unit}, limit {self.limit:g} {self.unit}"


@dataclass(frozen=True)
class Check:
    """One check; value, sd and limit are those of its worst number, None where it has none."""

    id: CheckId
    verdict: Verdict
    value: float | None
    """In `unit`."""
    sd: float | None
    """Standard deviation of `value`, in `unit`: noise and whatever else limits it."""
    limit: float | None
    """In `unit`."""
    unit: str
    """Empty: a pure number, or none."""
    reason: str
    remedy: str = ""
    """What helps; empty where nothing has to be done."""
    evidence: tuple[str, ...] = ()
    """Every number and fact that the check rests on."""
    suspects: tuple[str, ...] = ()  # empty: nothing is off, or it has no name
    """What is off; several: all of them, or one of them and nothing tells which, as the reason says."""

    def because_of(self, cause: CheckId) -> Check:
        """The check as a consequence of another failure, before whose repair the sensor cannot be judged."""
        reason = f"{self.reason} This follows from {cause}, which failed."
        remedy = f"Mend {cause} first, then check again."
        return dataclasses.replace(self, verdict=Verdict.UNKNOWN, reason=reason, remedy=remedy, suspects=())


@dataclass(frozen=True)
class Report:
    """Every check, in the order of :class:`CheckId`."""

    checks: tuple[Check, ...]

    @property
    def verdict(self) -> Verdict:
        """The whole report: any failure fails it, then warnings count, then what could not be checked."""
        found = {check.verdict for check in self.checks}
        order = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
        return next((verdict for verdict in order if verdict in found), Verdict.PASS)

    @property
    def summary(self) -> str:
        """One sentence: fit, or the reasons against it."""
        named = {v: [c.id.value for c in self.checks if c.verdict == v] for v in Verdict}
        if self.verdict == Verdict.PASS:
            return f"All {len(self.checks)} checks pass: this vehicle would arm now."
        phrases = [f"{', '.join(ids)} {one if len(ids) == 1 else more}" for v, one, more in _WORDS if (ids := named[v])]
        return f"{len(named[Verdict.PASS])} of {len(self.checks)} checks pass; {'; '.join(phrases)}."

    def check(self, of: CheckId) -> Check:
        """The check of that id."""
        return next(check for check in self.checks if check.id == of)


_WORDS = (
    (Verdict.FAIL, "failed", "failed"),
    (Verdict.WARN, "deserves a look", "deserve a look"),
    (Verdict.UNKNOWN, "could not be checked", "could not be checked"),
)


def unknown(of: CheckId, reason: str, remedy: str = "", evidence: Sequence[str] = ()) -> Check:
    """A check that cannot be made."""
    return Check(of, Verdict.UNKNOWN, None, None, None, "", reason, remedy, tuple(evidence))


def judged(of: CheckId, measures: Sequence[Measure], *, good: str, remedy: str, notes: Sequence[str] = ()) -> Check:
    """The check with these measures; the worst one decides.

    `good` is the reason of a pass. A number too uncertain for a verdict makes the check unknown only if no other one
    decides it.
    """
    worst = max(measures, key=_badness)
    verdict = worst.verdict
    evidence = (*(m.text for m in measures), *notes)
    reasons = {
        Verdict.PASS: good,
        Verdict.WARN: f"{_number(worst)}: beyond the limit of {worst.limit:g} {worst.unit}, not beyond doubt.",
        Verdict.FAIL: f"{_number(worst)}: beyond the limit of {worst.limit:g} {worst.unit}.",
        Verdict.UNKNOWN: f"{_number(worst)}: too uncertain to compare with {worst.limit:g} {worst.unit}.",
    }
    bad = verdict in (Verdict.WARN, Verdict.FAIL)
    help_ = "" if verdict == Verdict.PASS else worst.remedy or remedy
    reason = f"{reasons[verdict]} {worst.witness}" if bad and worst.witness else reasons[verdict]
    suspects = worst.suspects if bad else ()
    return Check(of, verdict, worst.value, worst.sd, worst.limit, worst.unit, reason, help_, evidence, suspects)


def counted(judged_: int, installed: int, one: str, more: str) -> str:
    """Subject of a sentence on sensors; "all" only if all installed ones were judged (0: as many as judged)."""
    if judged_ < installed:
        return f"{judged_} of {installed} {more}"
    return f"The only {one}" if judged_ == 1 else f"All {judged_} {more}"


def _badness(measure: Measure) -> tuple[int, float]:
    order = (Verdict.PASS, Verdict.UNKNOWN, Verdict.WARN, Verdict.FAIL)
    return order.index(measure.verdict), measure.value / measure.limit if measure.limit > 0.0 else measure.value


def _number(measure: Measure) -> str:
    return f"{measure.of} is {measure.value:.3g} ± {measure.sd:.2g} {measure.unit}"


_ORDER = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)


@dataclass(frozen=True)
class Readiness:
    """What a preflight after the write says; the event `readiness` carries the same."""

    verdict: Verdict
    """That of the preflight; unknown: the vehicle could not be looked at."""
    text: str
    """This vehicle would arm now, or what stands against it in its own words."""
    against: tuple[str, ...] = ()
    """Every check that does not pass, failures first."""


def readiness(report: Report) -> Readiness:
    """The report in a sentence, and the reasons against arming."""
    against = tuple(f"{c.id.value}: {c.reason}" for v in _ORDER for c in report.checks if c.verdict == v)
    prearm = report.check(CheckId.VEHICLE_PREARM)
    if report.verdict == Verdict.PASS:
        text = report.summary
    elif report.verdict == Verdict.FAIL and prearm.verdict == Verdict.PASS:
        text = f"Not fit to fly, although the vehicle itself would arm: {report.summary}"
    elif prearm.verdict == Verdict.PASS:
        text = f"This vehicle would arm now. {report.summary}"
    elif prearm.verdict == Verdict.UNKNOWN:
        text = f"Whether this vehicle would arm now is not known. {prearm.reason}"
    else:
        text = prearm.reason
    return Readiness(report.verdict, text, against)


def unchecked(why: str) -> Readiness:
    """There is no report, for this reason."""
    return Readiness(Verdict.UNKNOWN, f"Whether this vehicle would arm now was not checked: {why}")


@dataclass(frozen=True)
class VerifiedCalibration:
    """A calibration that was written and verified, or measured and found in force."""

    job: str
    at: float
    """When, wall-clock seconds since 1970."""
    sensors: frozenset[Sensor]
    device_ids: Mapping[str, int]
    """Keys as in :class:`calib.firmware.plan.Fingerprint`: ``accel0`` ..."""
    parameters: Mapping[str, Value]
    """Every calibration parameter as it stood afterwards."""
    temperatures: Mapping[int, float] = field(default_factory=dict)
    """Temperatures of the accelerometers' calibration, degC, by instance."""
    heard: frozenset[int] = frozenset()
    """Device ids of the sensors that sent samples then; PX4 also keeps ids of sensors that are not there."""
    uid: str | None = None
    """Unique id of the autopilot; None: not known."""
    stated: Mapping[tuple[Sensor, int], int] = field(default_factory=dict)
    """PX4: device ids stated by an operator, by streamed instance, since no stream contains them."""


def stated_device_ids(
    history: Iterable[VerifiedCalibration], parameters: Mapping[str, Value]
) -> dict[tuple[Sensor, int], int]:
    """The latest stated device ids that a row of a PX4 with `parameters` contains."""
    return still_held({key: device for entry in history for key, device in entry.stated.items()}, parameters)


@dataclass(frozen=True)
class Shaking:
    """The message VIBRATION: levels in m/s2 and clips since the start, of every unit."""

    levels: tuple[float, ...]
    clips: tuple[int, ...]


@dataclass(frozen=True)
class OwnView:
    """The vehicle's own report. None: not reported."""

    present: bool | None = None
    """Whether SYS_STATUS has the bit of the prearm check among what is present and switched on; None: not heard."""
    ready: bool | None = None
    """Whether it would arm: ArduPilot by the healthy state of that bit, PX4 also by its heartbeat."""
    asked: bool = False
    """Whether it took the request to run its checks."""
    texts: tuple[str, ...] = ()
    """Texts against arming since then."""
    calibrating: bool | None = None
    ill: frozenset[Sensor] = frozenset()
    """Kinds of sensors reported as present, enabled and not healthy (SYS_STATUS, texts)."""


@dataclass(frozen=True)
class Snapshot:
    """A few seconds of one vehicle at rest.

    Parameters
    ----------
    recording
        Inertial units and compasses as the vehicle uses them: corrected, in its body frame.
    identity, parameters
        Whose, and its calibration and arming parameters.
    now
        Wall-clock time, s since 1970.
    history
        Verified calibrations of this vehicle, oldest first.
    heading
        True heading of the nose that the operator knows, deg; None: not known.
    current_known
        Whether a battery current was heard; None: no battery message at all.
    """

    recording: Recording
    identity: Identity
    parameters: Mapping[str, Value]
    now: float
    history: tuple[VerifiedCalibration, ...] = ()
    shaking: Shaking | None = None
    view: OwnView = OwnView()
    heading: float | None = None
    current_known: bool | None = None
    rewritten: tuple[str, ...] = ()
    """Calibration parameters that changed during the snapshot."""
    complete: bool = True
    """Whether every parameter was read, so that a missing one does not exist on the vehicle."""
    messages: Mapping[int, int] | None = None
    """How many messages came with the inertial unit and the compass of each instance; None: not counted."""
    uncorrected: frozenset[tuple[Sensor, int]] = frozenset()
    """Streamed sensors whose calibration in force is not known."""

    @property
    def stated(self) -> dict[tuple[Sensor, int], int]:
        """See :func:`stated_device_ids`."""
        return stated_device_ids(self.history, self.parameters)


@dataclass(frozen=True)
class Subject:
    """The checks of one module that need the snapshot alone."""

    checks: tuple[Callable[[Snapshot], Check], ...]
    parameters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """What the module's checks look at and no calibration has, by autopilot; no other parameter is read for them."""
