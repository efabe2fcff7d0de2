"""Capacity of a link, and the stream rates that fit into it.

A telemetry radio carries a few kilobytes a second. Asked for more, it loses frames at random, parameter answers among
them. Rates are therefore chosen below its measured capacity, and a job is told how much longer it will take.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.link.endpoint import Endpoint, EndpointKind

SHARE = 0.7
"""Share of the capacity that streams may take: the rest is for parameters, commands and other programs."""
BACKGROUND_BYTES_PER_S = 100.0
"""Load of HEARTBEAT, STATUSTEXT and other unrequested messages."""
SLOW_HZ = 2.0
"""Rate up to which a stream is state, not samples, and is never reduced."""
LOSSY = 0.1
"""Share of losses above which a link is overloaded."""
EXACT_HZ = 50.0
"""Rate up to which both firmwares deliver the requested rate; slower streams are then held up by the link."""
HELD_UP = 0.8
"""Share of a stream's samples below which it is held up at its source by a full port."""
SHORT = 0.03
"""Relative overload from which a port fills its buffer; less may be chance."""
MORE = 1.2
"""Factor over the largest load carried before that disproves an earlier capacity; less may be chance."""
STEP = 0.25
"""Least share to which a rate is cut at once; the capacity is measured again in between."""
_LEAST_COMES = 0.1  # of a link that loses more nothing is inferred
_OVERHEAD = 12
_BITS_PER_BYTE = 10  # a start bit and a stop bit go with every eight


@dataclass(frozen=True)
class Arrivals:
    """Rates, loss and delay of streams while they were watched, from the first sample on.

    Parameters
    ----------
    own_hz
        Messages per second of the vehicle's own time stamps.
    wall_hz
        Messages per second of the wall clock.
    loss
        Share of the frames that were sent and did not come, by their sequence numbers, 0..1.
    bytes_per_s
        Everything that came, per second of the wall clock.
    queued
        By how many s in each s the samples come later and later.
    """

    own_hz: Mapping[int, float] = field(default_factory=dict)
    wall_hz: Mapping[int, float] = field(default_factory=dict)
    loss: float = 0.0
    bytes_per_s: float = 0.0
    queued: Mapping[int, float] = field(default_factory=dict)

    @property
    def speed(self) -> float:
        """Seconds of the vehicle in one second of the wall clock; 1 but for simulated vehicles."""
        ratios = [self.wall_hz[key] / rate for key, rate in self.own_hz.items() if rate > 0 and self.wall_hz[key] > 0]
        return max([1.0, *ratios])

    @property
    def own_bytes_per_s(self) -> float:
        """Received bytes per second of the vehicle's time, in which rates are requested."""
        return self.bytes_per_s / self.speed

    def sent_share(self, requested_hz: Mapping[int, float]) -> float | None:
        """Share of the requested samples that the vehicle sent; None: no stream shows it.

        That of the stream that does best: a full link holds up all of them. One that never comes says nothing:
        firmwares accept some that they do not have. Nor does one that was asked for so fast that firmwares send
        less of it by themselves.
        """
        comes = max(1.0 - self.loss, _LEAST_COMES)
        shares = [self.own_hz[key] / rate / comes for key, rate in self._informative(requested_hz)]
        return max(shares) if shares else None

    def short(self, requested_hz: Mapping[int, float]) -> float:
        """Share of the requested samples that the link did not carry: not sent, or waiting in a buffer."""
        informative = self._informative(requested_hz)
        if not informative:
            return 0.0
        came = sum(self.own_hz[key] for key, _ in informative) / sum(rate for _, rate in informative)
        queued = min(self.queued.get(key, 0.0) for key, _ in informative)
        return max(1.0 - came / max(1.0 - self.loss, _LEAST_COMES), 0.0) + queued

    def _informative(self, requested_hz: Mapping[int, float]) -> list[tuple[int, float]]:
        return [
            (key, rate)
            for key, rate in requested_hz.items()
            if SLOW_HZ < rate <= EXACT_HZ and self.own_hz.get(key, 0.0) > 0
        ]


def frame_bytes(message_id: int) -> int:
    """Largest size of this message as a MAVLink 2 frame. Unknown messages count as the largest possible."""
    cls = dialect.mavlink_map.get(message_id)
    payload = int(cls.unpacker.size) if cls is not None else 255
    return payload + _OVERHEAD


def nominal_capacity(endpoint: Endpoint) -> float | None:
    """Bytes per second that a serial port can carry at its baud rate; None if unknown.

    A flight controller's own USB port (``ttyACM``, ``by-id``) ignores the rate. A radio behind an adapter (``ttyUSB``)
    does not, and may be even slower over the air, so it is measured.
    """
    if endpoint.kind is not EndpointKind.SERIAL or "ACM" in endpoint.path or "by-id" in endpoint.path:
        return None
    return endpoint.baud / _BITS_PER_BYTE


def unlimited(endpoint: Endpoint) -> bool:
    """Whether the link has no limit worth measuring, as to a simulated vehicle on this machine.

    Late or missing samples then lack processor time, and fewer streams would not help.
    """
    return endpoint.kind is EndpointKind.SIM


def bytes_needed(rates_hz: Mapping[int, float], sizes: Mapping[int, int]) -> float:
    """Bytes per second that these streams take at these rates."""
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


def seen_capacity(requested_hz: Mapping[int, float], seen: Arrivals, *, late: bool) -> float | None:
    """Measured capacity of a link, bytes per second of the vehicle's time; None if it carried everything.

    It is too slow if it loses many frames, or if the vehicle's full port holds back many samples. So it is if a
    buffer fills and answers wait behind the samples.

    Parameters
    ----------
    requested_hz
        What was asked for.
    seen
        What came.
    late
        Whether answers were late meanwhile.
    """
    share = seen.sent_share(requested_hz)
    held_up = share is not None and share < HELD_UP
    filling = late and seen.short(requested_hz) > SHORT
    return seen.own_bytes_per_s if seen.loss > LOSSY or held_up or filling else None


def lowered(requested_hz: Mapping[int, float], capacity_bytes_per_s: float | None) -> dict[int, float]:
    """Rates as by :func:`plan_rates`, but none is cut by more than one step at once."""
    planned = plan_rates(requested_hz, capacity_bytes_per_s)
    return {key: max(rate, min(STEP * requested_hz[key], requested_hz[key])) for key, rate in planned.items()}


def helped(before_hz: Mapping[int, float], before: Arrivals, after_hz: Mapping[int, float], after: Arrivals) -> bool:
    """Whether lower rates have relieved the link; if not, the samples are not what congests it.

    A link that loses the same share of a smaller load is bad, not slow. A vehicle that still sends the same small share
    is slow itself. One that carries more of less than it was said to carry at all was measured wrongly.
    """
    if before.loss > LOSSY and after.loss > before.loss / 2:
        return False
    if after.own_bytes_per_s > MORE * before.own_bytes_per_s:
        return False
    was, now = before.sent_share(before_hz), after.sent_share(after_hz)
    if was is None or now is None or was >= HELD_UP:
        return True
    return now >= min(HELD_UP, was + SHORT)


def samples(rates_hz: Mapping[int, float], refused: Collection[int] = ()) -> tuple[int, ...]:
    """The streams that are measured: fast ones that the vehicle did not refuse."""
    return tuple(key for key, rate in rates_hz.items() if rate > SLOW_HZ and key not in refused)


def slowdown(requested_hz: Mapping[int, float], granted_hz: Mapping[int, float]) -> float:
    """How many times longer it takes to collect as many samples as planned; 1 if nothing was slowed down.

    Streams that do not come at all are left out: no patience helps there.
    """
    ratios = [rate / granted_hz[key] for key, rate in requested_hz.items() if granted_hz.get(key, 0.0) > 0]
    return max([1.0, *ratios])
