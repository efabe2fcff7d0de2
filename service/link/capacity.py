"""How much a link carries, and which stream rates fit into that.

A telemetry radio carries a few kilobytes a second. Asked for more, it loses frames at random, parameter answers
among them; so rates are chosen below what it was seen to carry, and a job is told how much longer it will take.
"""

from __future__ import annotations

from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.link.endpoint import Endpoint, EndpointKind

SHARE = 0.7
"""Share of the capacity that streams may take: the rest is for parameters, commands and other programs."""
BACKGROUND_BYTES_PER_S = 100.0
"""HEARTBEAT, STATUSTEXT and what else comes unasked."""
SLOW_HZ = 2.0
"""Streams this slow are state, not samples: they are never thinned out."""
LOSSY = 0.1
"""A link that loses more than this share is asked for more than it carries."""
EXACT_HZ = 50.0
"""Up to this rate both firmwares deliver what is asked for; what comes slower is held up by the link."""
HELD_UP = 0.8
_OVERHEAD = 12
_SIGNATURE = 13
_BITS_PER_BYTE = 10  # a start bit and a stop bit go with every eight


def frame_bytes(message_id: int, *, signed: bool = False) -> int:
    """Largest size of this message as a MAVLink 2 frame. Unknown messages count as the largest possible."""
    cls = dialect.mavlink_map.get(message_id)
    payload = int(cls.unpacker.size) if cls is not None else 255
    return payload + _OVERHEAD + (_SIGNATURE if signed else 0)


def nominal_capacity(endpoint: Endpoint) -> float | None:
    """Bytes per second that a serial port can carry at its baud rate; None where nothing is known beforehand.

    A flight controller's own USB port (``ttyACM``, ``by-id``) ignores the rate; a radio behind an adapter
    (``ttyUSB``) does not, and may be slower still over the air: measure.
    """
    if endpoint.kind is not EndpointKind.SERIAL or "ACM" in endpoint.path or "by-id" in endpoint.path:
        return None
    return endpoint.baud / _BITS_PER_BYTE


def unlimited(endpoint: Endpoint) -> bool:
    """Whether the link carries whatever is asked for: our own simulated vehicle is on this machine.

    What comes late of it, or not at all, wants for processor time, and fewer streams would be no remedy.
    """
    return endpoint.kind is EndpointKind.SIM


def bytes_needed(rates_hz: Mapping[int, float], sizes: Mapping[int, int]) -> float:
    """Bytes per second of these streams."""
    return sum(rate * sizes[message_id] for message_id, rate in rates_hz.items())


def plan_rates(
    requested_hz: Mapping[int, float], capacity_bytes_per_s: float | None, sizes: Mapping[int, int] | None = None
) -> dict[int, float]:
    """Rates that fit into the capacity: all sample streams are slowed down by one factor.

    Parameters
    ----------
    requested_hz
        Rate for each message id.
    capacity_bytes_per_s
        What the link carries; None: no limit is known, nothing is changed.
    sizes
        Bytes of each frame; None: those of the dialect.
    """
    known = sizes or {message_id: frame_bytes(message_id) for message_id in requested_hz}
    budget = None if capacity_bytes_per_s is None else SHARE * capacity_bytes_per_s - BACKGROUND_BYTES_PER_S
    if budget is None or bytes_needed(requested_hz, known) <= budget:
        return dict(requested_hz)
    state = {message_id: rate for message_id, rate in requested_hz.items() if rate <= SLOW_HZ}
    samples = {message_id: rate for message_id, rate in requested_hz.items() if rate > SLOW_HZ}
    left = max(budget - bytes_needed(state, known), 0.0)
    factor = left / bytes_needed(samples, known) if samples else 1.0
    return {**state, **{message_id: max(rate * factor, 1.0) for message_id, rate in samples.items()}}


def seen_capacity(
    requested_hz: Mapping[int, float],
    measured_hz: Mapping[int, float],
    loss: float,
    bytes_per_s: float,
) -> float | None:
    """What a link was seen to carry, in bytes per second; None if it carried everything.

    It is too slow if it loses many frames, or if every stream comes slower than the firmware would send it. A stream
    that never comes at all says nothing: firmwares accept some that they do not have.

    Parameters
    ----------
    requested_hz, measured_hz
        What was asked for and what came.
    loss
        Lost share of all frames meanwhile, 0..1.
    bytes_per_s
        Everything that came.
    """
    coming = {key: measured_hz[key] for key in requested_hz if measured_hz.get(key, 0.0) > 0}
    telling = [key for key in coming if SLOW_HZ < requested_hz[key] <= EXACT_HZ]
    held_up = bool(telling) and all(coming[key] < HELD_UP * requested_hz[key] for key in telling)
    return bytes_per_s if loss > LOSSY or held_up else None


def slowdown(requested_hz: Mapping[int, float], granted_hz: Mapping[int, float]) -> float:
    """How many times longer it takes to collect as many samples as planned; 1 if nothing was slowed down.

    Streams that do not come at all are left out: no patience helps there.
    """
    ratios = [rate / granted_hz[key] for key, rate in requested_hz.items() if granted_hz.get(key, 0.0) > 0]
    return max([1.0, *ratios])
