"""A snapshot of the vehicle from a few seconds of frames, and the messages to request for it."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import calibration_in_force, calibration_names
from mavcal.calib.firmware.names import BOARD_ROTATION, PX4_LEVEL, PX4_SLOTS, Role, px4_names
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import NO_DEVICE_IDS, px4_instance, px4_slot
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.stream.messages import HIGHRES_IMU, SCALED_IMU
from mavcal.calib.firmware.stream.rates import BY_INSTANCE, requested_streams
from mavcal.calib.preflight.check import OwnView, Shaking
from mavcal.calib.preflight.rest import LEAST
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage
from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.frames import Frame

VIBRATION = dialect.MAVLINK_MSG_ID_VIBRATION
SYS_STATUS = dialect.MAVLINK_MSG_ID_SYS_STATUS
STATUSTEXT = dialect.MAVLINK_MSG_ID_STATUSTEXT
HEARTBEAT = dialect.MAVLINK_MSG_ID_HEARTBEAT
PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
_HEALTH = {
    Sensor.GYRO: dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO | dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO2,
    Sensor.ACCEL: dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL2,
    Sensor.MAG: dialect.MAV_SYS_STATUS_SENSOR_3D_MAG | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG2,
}
_STANDING = {dialect.MAV_STATE_STANDBY: True, dialect.MAV_STATE_UNINIT: False}
"""PX4's state in its heartbeat: standby only if its own checks pass (FLIGHT_CONTROLLERS 3.3)."""
SENSORS = frozenset({Sensor.ACCEL, Sensor.GYRO, Sensor.MAG})
STATE_HZ = 2.0
ATTITUDE_HZ = 5.0
AGAINST = ("PreArm:", "Preflight Fail", "Arming denied", "Arm:")
"""Beginnings of both firmwares' texts against arming."""


def preflight_streams(autopilot: str) -> dict[int, float]:
    """Rates in Hz by message id. Raises FirmwareError if the autopilot is neither ArduPilot nor PX4."""
    wanted = requested_streams(autopilot, SENSORS)
    wanted[dialect.MAVLINK_MSG_ID_ATTITUDE] = ATTITUDE_HZ
    return wanted | {VIBRATION: STATE_HZ, SYS_STATUS: STATE_HZ}


def wanted_messages(identity: Identity) -> frozenset[int]:
    """Ids of the messages to keep."""
    return Assembler(identity).message_ids | {VIBRATION, SYS_STATUS, HEARTBEAT}


def counted_messages(frames: Iterable[Frame], autopilot: str) -> dict[int, int]:
    """How many messages came with the inertial unit and the compass of each instance (0, 1, 2)."""
    by_id = Counter(frame.message_id for frame in frames)
    found = {i: by_id[message_id] for i, message_id in enumerate(BY_INSTANCE[autopilot])}
    if autopilot == "ardupilot":
        found[0] = max(found[0], by_id[SCALED_IMU], by_id[HIGHRES_IMU])
    return found


ENOUGH = LEAST + 5
"""Messages of an instance that suffice to judge its sensors, allowing for spikes and invalid ones."""
ENOUGH_S = 3.0
"""Time, s, of the vehicle's clock that suffices: a compass is read ten times a second."""


@dataclasses.dataclass(frozen=True)
class Gathered:
    """Progress of the streams."""

    messages: Mapping[int, int]
    """Number of messages by instance, for instances with any."""
    enough: bool
    still: frozenset[int] = frozenset()
    """Compasses with a constant reading while another changes, or alone: a compass quieter than one step of its message
    may still change. If none of several changes, more time does not help."""

    @property
    def text(self) -> str:
        """Progress in words."""
        if not self.messages:
            return "no message of an inertial unit came"
        return f"{min(self.messages.values())} messages of the slowest inertial unit came"


def gathered(frames: Iterable[Frame], autopilot: str) -> Gathered:
    """Whether these frames of one vehicle are enough to judge every sensor that sends."""
    frames = list(frames)
    kept = [frame for frame in frames if frame.message_id in BY_INSTANCE[autopilot]]
    found = {i: count for i, count in counted_messages(kept, autopilot).items() if count}
    if not found or min(found.values()) < ENOUGH:
        return Gathered(found, enough=False)
    seconds = watched_s(kept, autopilot)
    enough = seconds >= ENOUGH_S or seconds < 0.0
    return Gathered(found, enough, _still(frames, autopilot) if enough else frozenset())


def watched_s(frames: Iterable[Frame], autopilot: str) -> float:
    """Seconds of the vehicle's own clock between the first and the last sample; negative after a restart."""
    kept = [frame for frame in frames if frame.message_id in BY_INSTANCE[autopilot]]
    return 0.0 if not kept else _stamp(decode(kept[-1])) - _stamp(decode(kept[0]))


def without_words(frames: Iterable[Frame]) -> list[Frame]:
    """The frames without STATUSTEXT and SYS_STATUS, which belong to the vehicle's earlier checks."""
    return [frame for frame in frames if frame.message_id not in (STATUSTEXT, SYS_STATUS)]


def _still(frames: Iterable[Frame], autopilot: str) -> frozenset[int]:
    instances = {HIGHRES_IMU: 0} | {message_id: i for i, message_id in enumerate(BY_INSTANCE[autopilot])}
    seen: dict[int, set[tuple[int, float, float, float]]] = {}
    messages: dict[int, set[int]] = {}
    for frame in frames:
        if frame.message_id not in instances:
            continue
        message = decode(frame)
        field = (message.xmag, message.ymag, message.zmag)
        if any(field):
            instance = instances[frame.message_id]
            seen.setdefault(instance, set()).add((frame.message_id, *field))
            messages.setdefault(instance, set()).add(frame.message_id)
    still = frozenset(i for i, values in seen.items() if len(values) == len(messages[i]))
    return still if len(still) < len(seen) or len(seen) == 1 else frozenset()


def _stamp(message: Any) -> float:
    return float(message.time_usec) * 1e-6 if hasattr(message, "time_usec") else float(message.time_boot_ms) * 1e-3


@dataclasses.dataclass(frozen=True)
class Collected:
    """Contents of the frames."""

    recording: Recording
    """Corrected, in the body frame."""
    shaking: Shaking | None
    view: OwnView
    current_known: bool | None
    messages: Mapping[int, int]
    """See :attr:`calib.preflight.check.Snapshot.messages`."""
    uncorrected: frozenset[tuple[Sensor, int]]
    """See :attr:`calib.preflight.check.Snapshot.uncorrected`."""


def collect(
    frames: Sequence[Frame],
    identity: Identity,
    parameters: Mapping[str, Value],
    *,
    asked: bool,
    complete: bool = True,
    stated: Mapping[tuple[Sensor, int], int] = NO_DEVICE_IDS,
) -> Collected:
    """Read `frames` of one vehicle, in their order.

    `asked`: it accepted the request to run its checks. `complete`: every parameter was read, so that a missing one does
    not exist. A compass whose correction is uncertain is left out. `stated`: PX4's device ids by streamed instance,
    from :func:`calib.preflight.check.stated_device_ids`.
    """
    assembler = Assembler(identity, parameters)
    recording = assembler.feed([(None, frame) for frame in frames])
    shaking = _shaking(_last(frames, VIBRATION), identity.autopilot or "")
    texts = [e.text for e in recording.events if e.kind == "text" and e.text.startswith(AGAINST)]
    status = _last(frames, SYS_STATUS)
    view = OwnView(asked=asked, texts=tuple(dict.fromkeys(text.strip() for text in texts)))
    if status is not None:
        there = int(status.onboard_control_sensors_present) & int(status.onboard_control_sensors_enabled)
        health = int(status.onboard_control_sensors_health)
        ready: bool | None = bool(health & PREARM)
        if identity.autopilot == "px4":
            ready = _ready(frames, ready=bool(health & PREARM), reported=bool(there & PREARM))
        elif not there & PREARM:
            ready = None
        ill = frozenset(sensor for sensor, bits in _HEALTH.items() if there & bits & ~health)
        view = dataclasses.replace(view, present=bool(there & PREARM), ready=ready, ill=ill)
    current = None if status is None else int(status.current_battery) >= 0
    made = [(c, _corrected(c, identity, parameters, stated, complete=complete)) for c in recording.channels]
    return Collected(
        recording.with_channels(c for _, c in made if c is not None),
        shaking,
        view,
        current,
        counted_messages(frames, identity.autopilot or ""),
        frozenset((c.sensor, c.instance) for c, corrected in made if corrected is None),
    )


def _ready(frames: Sequence[Frame], *, ready: bool, reported: bool) -> bool | None:
    """Whether the vehicle is ready: PX4 sets the prearm bit only in the healthy mask, else the heartbeat decides."""
    if ready or reported:
        return ready
    heartbeat = _last(frames, HEARTBEAT)
    return None if heartbeat is None else _STANDING.get(int(heartbeat.system_status))


def _corrected(
    channel: Channel,
    identity: Identity,
    parameters: Mapping[str, Value],
    stated: Mapping[tuple[Sensor, int], int],
    *,
    complete: bool,
) -> Channel | None:
    """The channel as the vehicle uses it; None: the calibration in force is not known.

    PX4 streams its compasses raw, so the calibration in force is applied.
    """
    if channel.stage != Stage.RAW or channel.sensor != Sensor.MAG:
        return channel
    try:
        slot = px4_slot(parameters, Sensor.MAG, channel.instance, stated)
        place = px4_instance(parameters, Sensor.MAG, slot)
        model = calibration_in_force(identity.autopilot, parameters, Sensor.MAG, place)
        row = calibration_names(identity.autopilot, parameters, Sensor.MAG, place)
    except CalibError:
        return None
    ids = {px4_names(Sensor.MAG, slot)[Role.ID] for slot in range(PX4_SLOTS)}  # which row is whose
    board = {BOARD_ROTATION["px4"], *PX4_LEVEL}
    if not complete and not (ids | board | set(row.values())) <= set(parameters):
        return None
    # valid at rest: a rotated bin has no zero of its own, and the motors are off
    return dataclasses.replace(channel, values=model.apply(channel.values), stage=Stage.CORRECTED, zero_bin=None)


def _shaking(message: Any, autopilot: str) -> Shaking | None:
    """Levels in m/s2: PX4's x and y are of the gyroscopes (its VIBRATION.hpp)."""
    if message is None:
        return None
    levels = (message.vibration_x, message.vibration_y, message.vibration_z)
    clips = (message.clipping_0, message.clipping_1, message.clipping_2)
    return Shaking(levels[2:] if autopilot == "px4" else levels, clips)


def _last(frames: Sequence[Frame], message_id: int) -> Any:
    found = next((frame for frame in reversed(frames) if frame.message_id == message_id), None)
    return None if found is None else decode(found)
