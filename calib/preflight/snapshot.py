"""Input of a preflight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import px4_sensor_ids
from mavcal.calib.recording import Identity, Recording, Sensor


@dataclass(frozen=True)
class VerifiedCalibration:
    """A calibration that was written and verified, or measured and found in force."""

    job: str
    at: float
    """When, wall-clock seconds since 1970."""
    sensors: frozenset[Sensor]
    device_ids: Mapping[str, int]
    """As of :class:`calib.firmware.plan.Fingerprint`: ``accel0`` ..."""
    parameters: Mapping[str, Value]
    """Every calibration parameter as it stood afterwards."""
    temperatures: Mapping[int, float] = field(default_factory=dict)
    """At which the accelerometers were calibrated, degC by instance."""
    uid: str | None = None
    """Unique id of the autopilot; None: not known."""
    stated: Mapping[tuple[Sensor, int], int] = field(default_factory=dict)
    """PX4: device ids that somebody stated, by streamed instance: no stream says them."""


def stated_device_ids(
    history: Iterable[VerifiedCalibration], parameters: Mapping[str, Value]
) -> dict[tuple[Sensor, int], int]:
    """The device ids that were stated last, as far as a row of a PX4 with `parameters` holds them."""
    held = {(sensor, device) for (sensor, _), device in px4_sensor_ids(parameters).items()}
    found = {key: device for entry in history for key, device in entry.stated.items()}
    return {key: device for key, device in found.items() if (key[0], device) in held}


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
    """Whether it would arm: ArduPilot by that bit among what is healthy, PX4 by that bit and by its heartbeat."""
    asked: bool = False
    """Whether it took the request to run its checks."""
    texts: tuple[str, ...] = ()
    """What it said against arming since then."""
    calibrating: bool | None = None
    ill: frozenset[Sensor] = frozenset()
    """Kinds of sensors: it says that one of these is present, switched on and not healthy (SYS_STATUS, its texts)."""


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
        VerifiedCalibration calibrations of this vehicle, oldest first.
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
    """Calibration parameters that took another value meanwhile."""
    complete: bool = True
    """Whether every parameter was read: one that is not there then is one that the vehicle does not have."""
    messages: Mapping[int, int] | None = None
    """How many messages came with the inertial unit and the compass of each instance; None: not counted."""
    uncorrected: frozenset[tuple[Sensor, int]] = frozenset()
    """Sensors that were heard, and whose calibration in force is not known."""

    @property
    def stated(self) -> dict[tuple[Sensor, int], int]:
        """See :func:`stated_device_ids`."""
        return stated_device_ids(self.history, self.parameters)
