"""The present state of a vehicle, and whether it may be written to.

:func:`reduce` is pure: a state, a message and a time make the next state. All times are of the monotonic clock.
:func:`watch_calibration` reads every sign that a firmware gives of calibrating itself. Long texts come in chunks, by id
and number (:func:`add_chunk`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NoReturn

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message
from mavcal.calib.wire.texts import CHUNK_BYTES, joined_text, text_bytes
from mavcal.service.errors import VehicleArmed, VehicleBusy, VehicleConflict, VehicleError, VehicleSilent

SILENT_S = 3.0
"""A vehicle whose last heartbeat is older than this is silent (FLIGHT_CONTROLLERS 3.2: heartbeat age < 3 s)."""
DISARMED_S = 2.0
LANDED_FRESH_S = 10.0
"""Age from which a landed state counts as UNDEFINED, s."""
KEPT_TEXTS = 50
_CHUNKS_WAIT_S = 5.0
_MOST_TEXTS_WAITING = 8


class Landed(StrEnum):
    """EXTENDED_SYS_STATE.landed_state."""

    UNDEFINED = "undefined"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKEOFF = "takeoff"
    LANDING = "landing"


_LANDED = dict(enumerate(Landed))


@dataclass(frozen=True)
class VehicleState:
    """A snapshot. None means: not heard yet.

    Parameters
    ----------
    armed, disarmed_since
        From HEARTBEAT; `disarmed_since` is the time from which on every heartbeat said disarmed.
    landed, throttle
        EXTENDED_SYS_STATE and VFR_HUD (0..1), with the times they were heard.
    last_heard, last_heartbeat
        Any frame at all; a HEARTBEAT. Only the second proves that the vehicle is well: a frozen one may still answer.
    rebooted
        How many restarts were noticed by its clock going back.
    armings, silences, calibrations
        How often it armed, was silent for more than 3 s between two heartbeats, and began a calibration of its own:
        what came and went between two looks shows here.
    boot_time
        Latest time since boot that it stamped on a message, s.
    onboard_calibration
        The calibration that the vehicle runs by itself, or None.
    """

    armed: bool | None = None
    disarmed_since: float | None = None
    landed: Landed = Landed.UNDEFINED
    landed_at: float | None = None
    throttle: float | None = None
    throttle_at: float | None = None
    system_status: int | None = None
    custom_mode: int | None = None
    last_heard: float | None = None
    last_heartbeat: float | None = None
    rebooted: int = 0
    armings: int = 0
    silences: int = 0
    calibrations: int = 0
    boot_time: float | None = None
    onboard_calibration: OnboardCalibration | None = None
    texts: tuple[StatusText, ...] = ()
    _chunks: tuple[ChunkedText, ...] = ()

    def silent(self, now: float) -> bool:
        """True if the last heartbeat is too old or missing; `now` is the time until which the link was read."""
        return self.last_heartbeat is None or now - self.last_heartbeat > SILENT_S

    def evidence(self, now: float) -> tuple[str, ...]:
        """The observations behind this state, in sentences."""
        lines = []
        if self.last_heartbeat is None:
            lines.append("no HEARTBEAT heard yet")
        else:
            word = "armed" if self.armed else "disarmed"
            lines.append(f"HEARTBEAT {now - self.last_heartbeat:.1f} s ago: {word}, status {self.system_status}")
        if self.disarmed_since is not None:
            lines.append(f"disarmed for {now - self.disarmed_since:.1f} s")
        if self.landed_at is not None:
            lines.append(f"EXTENDED_SYS_STATE {now - self.landed_at:.1f} s ago: {self.landed}")
        if self.throttle_at is not None and self.throttle is not None:
            lines.append(f"VFR_HUD {now - self.throttle_at:.1f} s ago: throttle {self.throttle:.0%}")
        if self.onboard_calibration is not None:
            lines.append(self.onboard_calibration.text)
        if self.rebooted:
            lines.append(f"restarted {self.rebooted} times since it was found")
        return tuple(lines)


def changed(state: VehicleState, **changes: Any) -> VehicleState:
    """The state with some of its fields changed, as ``dataclasses.replace`` makes it.

    That costs 40 us, five times a second and vehicle: two fifths of what 1000 vehicles cost a service.
    """
    after = object.__new__(VehicleState)
    after.__dict__.update(state.__dict__, **changes)
    if len(after.__dict__) != len(state.__dict__):
        raise TypeError(f"no fields of a vehicle's state: {', '.join(sorted(changes.keys() - state.__dict__.keys()))}")
    return after


def reduce(state: VehicleState, message: Message, now: float, since: float | None = None) -> VehicleState:
    """The state after a message that arrived between `since` (None: `now`) and `now`."""
    kind = message.get_type()
    state = changed(state, last_heard=now)
    if kind == "HEARTBEAT":
        state = _heartbeat(state, message, now, now if since is None else since)
    elif kind == "EXTENDED_SYS_STATE":
        state = changed(state, landed=_LANDED.get(message.landed_state, Landed.UNDEFINED), landed_at=now)
    elif kind == "VFR_HUD":
        state = changed(state, throttle=message.throttle / 100.0, throttle_at=now)
    texts: tuple[StatusText, ...] = ()
    if kind == "STATUSTEXT":
        chunks, texts = add_chunk(state._chunks, message, now)
        state = changed(state, _chunks=chunks)
    if texts:
        state = changed(state, texts=(*state.texts, *texts)[-KEPT_TEXTS:])
    calibration = watch_calibration(state.onboard_calibration, message, texts, now)
    if calibration is not state.onboard_calibration:
        begun = calibration is not None and state.onboard_calibration is None
        state = changed(state, onboard_calibration=calibration, calibrations=state.calibrations + begun)
    return state


def _heartbeat(state: VehicleState, message: Message, now: float, since: float) -> VehicleState:
    armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
    gap = state.silent(since)
    disarmed_since = None if armed else now if state.disarmed_since is None or gap else state.disarmed_since
    return changed(
        state,
        armed=armed,
        armings=state.armings + (armed and not state.armed),
        silences=state.silences + (gap and state.last_heartbeat is not None),
        disarmed_since=disarmed_since,
        system_status=message.system_status,
        custom_mode=message.custom_mode,
        last_heartbeat=now,
    )


def restarted(state: VehicleState, boot_time: float | None) -> VehicleState:
    """The state of a vehicle that has just restarted: what it said before is no longer true."""
    return VehicleState(
        last_heard=state.last_heard,
        last_heartbeat=state.last_heartbeat,
        armed=state.armed,
        disarmed_since=None,
        system_status=state.system_status,
        custom_mode=state.custom_mode,
        rebooted=state.rebooted + 1,
        armings=state.armings,
        silences=state.silences,
        calibrations=state.calibrations,
        boot_time=boot_time,
        texts=state.texts,
    )


def expire(state: VehicleState, now: float) -> VehicleState:
    """Forget an onboard calibration that has not been heard of for long; the same state if there is none."""
    calibration = state.onboard_calibration
    if calibration is not None and calibration.over(now):
        return changed(state, onboard_calibration=None)
    return state


class Refusal(StrEnum):
    """Why a vehicle may not be written to."""

    SILENT = "silent"
    ARMED = "armed"
    NOT_LANDED = "not_landed"
    CALIBRATING = "calibrating"
    CONFLICT = "conflict"


@dataclass(frozen=True)
class Writable:
    """Whether a parameter may be written now; `reasons` say why not, `refusals` the same for programs."""

    ok: bool
    reasons: tuple[str, ...] = ()
    refusals: tuple[Refusal, ...] = ()


def writable(state: VehicleState, now: float) -> Writable:
    """Disarmed for 2 s, on the ground, no onboard calibration, heard within 3 s."""
    found: list[tuple[Refusal, str]] = []
    if state.silent(now):
        found.append((Refusal.SILENT, _silence(state, now)))
    if state.armed or state.armed is None:
        found.append((Refusal.ARMED, "the vehicle is armed" if state.armed else "it is not known to be disarmed"))
    elif state.disarmed_since is None or now - state.disarmed_since < DISARMED_S:
        found.append((Refusal.ARMED, f"the vehicle is not known to be disarmed for {DISARMED_S:g} s yet"))
    landed = _not_landed(state, now)
    if landed:
        found.append((Refusal.NOT_LANDED, landed))
    if state.onboard_calibration is not None and not state.onboard_calibration.over(now):
        found.append((Refusal.CALIBRATING, f"it is calibrating by itself: {state.onboard_calibration.text}"))
    return Writable(not found, tuple(text for _, text in found), tuple(refusal for refusal, _ in found))


def _silence(state: VehicleState, now: float) -> str:
    if state.last_heartbeat is None:
        return "no heartbeat was heard yet"
    since = f"no heartbeat for {now - state.last_heartbeat:.1f} s"
    if state.last_heard is not None and now - state.last_heard < SILENT_S:
        return f"{since}, although it still answers: it may have frozen and need a restart"
    return since


def _not_landed(state: VehicleState, now: float) -> str | None:
    fresh = state.landed_at is not None and now - state.landed_at <= LANDED_FRESH_S
    if fresh and state.landed is not Landed.UNDEFINED:
        return None if state.landed is Landed.ON_GROUND else f"the vehicle is not on the ground ({state.landed})"
    if state.throttle_at is None or now - state.throttle_at > LANDED_FRESH_S or state.throttle is None:
        return "it is not known whether the vehicle is on the ground: neither landed state nor throttle was heard"
    return None if state.throttle == 0 else f"its landed state is unknown and the throttle is {state.throttle:.0%}"


def refuse(found: Writable, name: str, sent: int) -> NoReturn:
    """Raise the error of the first refusal; `name` was sent `sent` times, or is empty for any write."""
    doing = f"{name} was not written" if name else "Nothing is written"
    if sent:
        doing = f"{name} was sent {sent} times and not confirmed; it is not sent again"
    text = f"{doing}: {'; '.join(found.reasons)}."
    errors: dict[Refusal, type[VehicleError]] = {
        Refusal.SILENT: VehicleSilent,
        Refusal.ARMED: VehicleArmed,
        Refusal.CONFLICT: VehicleConflict,
        Refusal.NOT_LANDED: VehicleBusy,
        Refusal.CALIBRATING: VehicleBusy,
    }
    error = next(errors[refusal] for refusal in errors if refusal in found.refusals)(text)
    error.sent = sent
    raise error


_POSE_SUCCESS, _POSE_FAILED = 16777215, 16777216
_MAG_RUNNING = {
    dialect.MAG_CAL_WAITING_TO_START,
    dialect.MAG_CAL_RUNNING_STEP_ONE,
    dialect.MAG_CAL_RUNNING_STEP_TWO,
}


class CalibrationSign(StrEnum):
    """The message that shows the calibration; the values are the names of messages."""

    HEARTBEAT = "HEARTBEAT"
    TEXT = "STATUSTEXT"
    POSE = "COMMAND_LONG"
    MAG = "MAG_CAL_PROGRESS"
    REPORT = "MAG_CAL_REPORT"


_STALE_S = {
    CalibrationSign.HEARTBEAT: 3.0,  # said again every second
    CalibrationSign.TEXT: 120.0,  # ends with a text, which may be lost
    CalibrationSign.POSE: 10.0,  # asked again every second
    CalibrationSign.MAG: 10.0,  # said again several times a second
    CalibrationSign.REPORT: 3.0,  # said again until it is accepted
}
"""Time after its last sign for which a calibration counts as running, s."""


@dataclass(frozen=True)
class OnboardCalibration:
    """A calibration that the vehicle runs by itself: its sign, and when it was first and last heard."""

    sign: CalibrationSign
    text: str
    since: float
    last: float

    def over(self, now: float) -> bool:
        """True if its last sign is so old that it must have ended unheard."""
        return now - self.last > _STALE_S[self.sign]


def watch_calibration(
    running: OnboardCalibration | None, message: Message, texts: tuple[StatusText, ...], now: float
) -> OnboardCalibration | None:
    """The calibration that runs after a message and the texts it completed; None: none runs."""
    kind = message.get_type()
    if kind == "HEARTBEAT":
        return _calibrating(running, message, now)
    for text in texts:
        running = _text(running, text, now)
    if kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_ACCELCAL_VEHICLE_POS:
        if int(message.param1) in (_POSE_SUCCESS, _POSE_FAILED):
            return None
        return _goes_on(running, CalibrationSign.POSE, "an accelerometer calibration asks for poses", now)
    if kind == "MAG_CAL_PROGRESS":
        if message.cal_status in _MAG_RUNNING:
            what = f"a compass calibration is at {message.completion_pct} %"
            return _goes_on(running, CalibrationSign.MAG, what, now)
        return None if running and running.sign is CalibrationSign.MAG else running
    if kind == "MAG_CAL_REPORT":
        return _report(running, message, now)
    return running


def _goes_on(running: OnboardCalibration | None, sign: CalibrationSign, text: str, now: float) -> OnboardCalibration:
    return OnboardCalibration(sign, text, running.since if running else now, now)


def _calibrating(running: OnboardCalibration | None, message: Message, now: float) -> OnboardCalibration | None:
    if message.system_status == dialect.MAV_STATE_CALIBRATING:
        return _goes_on(running, CalibrationSign.HEARTBEAT, "HEARTBEAT says that it is calibrating", now)
    if running is None or running.sign is CalibrationSign.HEARTBEAT:
        return None
    # the text that ends a calibration may be lost; the firmware that sends such texts shows the state here too
    ended_unheard = running.sign is CalibrationSign.TEXT and now - running.last > _STALE_S[CalibrationSign.HEARTBEAT]
    return None if ended_unheard else running


def _text(running: OnboardCalibration | None, text: StatusText, now: float) -> OnboardCalibration | None:
    what = text.text
    if not what.startswith("[cal]"):
        return running
    if any(word in what for word in ("calibration done", "calibration failed", "calibration cancelled")):
        return None
    if "started" in what or "progress" in what or "orientation detected" in what or "side done" in what:
        return _goes_on(running, CalibrationSign.TEXT, f"it said '{what}'", now)
    return running


def _report(running: OnboardCalibration | None, message: Message, now: float) -> OnboardCalibration | None:
    """The calibration that a MAG_CAL_REPORT shows.

    ArduPilot repeats its report until it is accepted or cancelled; accepting writes parameters. PX4 sends the same
    message, with fitness 0 and no radius, whenever any parameter changes: that is no calibration.
    """
    if message.fitness == 0 and message.autosaved == 0:
        return running
    if message.autosaved:
        return None if running and running.sign in (CalibrationSign.MAG, CalibrationSign.REPORT) else running
    what = "a compass calibration has ended and waits to be accepted or cancelled"
    return _goes_on(running, CalibrationSign.REPORT, what, now)


@dataclass(frozen=True)
class StatusText:
    """A complete text; severity 0 (emergency) to 7 (debug), time of the monotonic clock."""

    text: str
    severity: int
    at: float


@dataclass(frozen=True)
class ChunkedText:
    """A text whose end has not come yet."""

    id: int
    severity: int
    at: float
    pieces: tuple[tuple[int, bytes], ...]

    def complete(self) -> bool:
        """True if the last chunk, which is shorter, and all before it are there."""
        numbers = [number for number, _ in self.pieces]
        last = max(self.pieces)
        return len(last[1]) < CHUNK_BYTES and numbers == list(range(len(numbers)))

    def text(self, at: float) -> StatusText:
        """The received chunks joined, with a mark where one is missing."""
        pieces = dict(self.pieces)
        gap = "…".encode()
        joined = joined_text(pieces.get(number, gap) for number in range(max(pieces) + 1))
        return StatusText(joined, self.severity, at)


def add_chunk(
    waiting: tuple[ChunkedText, ...], message: Message, now: float
) -> tuple[tuple[ChunkedText, ...], tuple[StatusText, ...]]:
    """The texts still incomplete after a STATUSTEXT, and those that are now final."""
    done = [chunked.text(now) for chunked in waiting if now - chunked.at > _CHUNKS_WAIT_S]
    waiting = tuple(chunked for chunked in waiting if now - chunked.at <= _CHUNKS_WAIT_S)
    if message.id == 0:
        return waiting, (*done, StatusText(joined_text([text_bytes(message)]), message.severity, now))
    before = next((chunked for chunked in waiting if chunked.id == message.id), None)
    others = tuple(chunked for chunked in waiting if chunked.id != message.id)
    pieces = dict(before.pieces if before else ())
    pieces[message.chunk_seq] = text_bytes(message)
    chunked = ChunkedText(message.id, message.severity, before.at if before else now, tuple(sorted(pieces.items())))
    if chunked.complete():
        return others, (*done, chunked.text(now))
    return (*others, chunked)[-_MOST_TEXTS_WAITING:], tuple(done)
