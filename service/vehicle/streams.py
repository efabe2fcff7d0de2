"""Streams: request them, measure them, and restore the earlier rates.

An acknowledgement does not mean that a stream comes: PX4 accepts some and never sends them. Nor does it tell the rate,
since intervals are rounded. Only the measured rate counts.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mavcal.service.errors import LinkError, VehicleError
from mavcal.service.link.capacity import (
    SHORT,
    Arrivals,
    helped,
    lowered,
    nominal_capacity,
    plan_rates,
    samples,
    seen_capacity,
    slowdown,
    unlimited,
)
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.arrivals import watch
from mavcal.service.vehicle.intervals import DEFAULT_INTERVAL, get_interval, get_intervals, set_interval, set_intervals

if TYPE_CHECKING:
    from mavcal.service.vehicle.vehicle import Vehicle

LATE_S, LATER = 0.4, 3.0
"""Delay of answers, s and as a multiple of that before the streams, that means a full link."""
GROWTH, GROWN_S = SHORT, 0.06
"""Relative overload of a port, by which answers get later in s per s; and the s below which that may be chance."""
_ASKS, _ASKS_IDLE = 4, 2
"""Number of answers, with and without streams. One may be late by chance; if the quickest is late, a queue delays
it."""
_HARDLY = 0.7
_DRAIN_ASKS = 6
"""Most answers for which a full buffer is given time to empty."""
MOST_CUTS = 3
MEASURE_S = 2.0
"""Time for which streams are measured, s by the vehicle's own time stamps."""
FRESH_S = 60.0
"""Time, s, in which the assumed capacity of a slow link doubles while it is not measured again."""
REMEMBERED_S = 600.0
"""Time after which a measured capacity is dropped, s."""


@dataclass(frozen=True)
class StreamRate:
    """Requested and measured rate of one stream.

    Parameters
    ----------
    result
        MAV_RESULT of the request; None if it was not acknowledged.
    measured_hz
        Messages per second of the vehicle's time (of the wall clock for messages without a time stamp).
    wall_hz
        Messages per second of the wall clock.
    """

    message_id: int
    requested_hz: float
    result: int | None
    measured_hz: float
    wall_hz: float

    @property
    def delivered(self) -> bool:
        """Whether any message of the stream arrives."""
        return self.wall_hz > 0


@dataclass
class StreamReport:
    """Result of a request for streams; ``await restore()`` sets the old intervals again.

    Parameters
    ----------
    vehicle
        Whose streams.
    rates
        One entry for each message asked for; `requested_hz` is what was asked at first.
    previous
        The intervals in us as they were before: -1 off, 0 the firmware's default (also where the vehicle did not
        say). Streams that the vehicle refused to change are not among them.
    capacity_bytes_per_s
        What a slow link carries, for which the rates were lowered; None: it carries everything.
    """

    vehicle: Vehicle
    rates: Mapping[int, StreamRate]
    previous: Mapping[int, int]
    capacity_bytes_per_s: float | None = None

    @property
    def slowdown(self) -> float:
        """Time to collect as many samples, relative to that at the requested rates; 1: no slowdown."""
        if self.capacity_bytes_per_s is None:
            return 1.0
        requested = {message_id: rate.requested_hz for message_id, rate in self.rates.items()}
        return slowdown(requested, {message_id: rate.measured_hz for message_id, rate in self.rates.items()})

    @property
    def missing(self) -> tuple[int, ...]:
        """Messages that were asked for and do not come."""
        return tuple(message_id for message_id, rate in self.rates.items() if not rate.delivered)

    async def restore(self) -> tuple[int, ...]:
        """Restore the old intervals; returns the messages for which that was not confirmed."""
        vehicle = self.vehicle.unit
        ledger, way = vehicle.rates, vehicle.way
        await ledger.followed()
        before = ledger.before_us(way, self.previous)
        try:
            results = await set_intervals(vehicle, before)
        except (VehicleError, LinkError):
            return tuple(self.previous)
        failed = tuple(key for key, result in results.items() if not _is_restored(before[key], result))
        left = ledger.note_restored(way, tuple(key for key in self.previous if key not in failed))
        for link in vehicle.links:
            for message_id, interval in left.get(link.id, {}).items():
                vehicle.demand_over(link, commands.SET_MESSAGE_INTERVAL, message_id, interval)
        return failed


async def request_streams(
    vehicle: Vehicle,
    requested_hz: Mapping[int, float],
    *,
    measure_s: float = MEASURE_S,
    before: Mapping[int, int] | None = None,
) -> StreamReport:
    """Ask for streams, then measure what comes. Where the link is too slow for them, ask for less.

    A refusal does not raise: it is in the report, and the stream may come all the same. If this is cancelled half
    way, what was already changed is put back.

    Parameters
    ----------
    vehicle
        Whom to ask.
    requested_hz
        Rate for each message id; 0 switches it off.
    measure_s
        How long to watch, by the vehicle's time stamps, after each change. 0 leaves every measured rate at 0. It asks
        for what the link was seen to carry a moment ago; if that is longer ago, it is measured again all the same.
    before
        Intervals in us as they were, where that is known already; the vehicle is not asked for these.
    """
    request = _Request(vehicle, dict(requested_hz), dict(before or {}))
    fresh = _age_s(vehicle) <= FRESH_S
    if measure_s <= 0 and vehicle.carried is not None and not fresh:
        measure_s = MEASURE_S
    nominal = nominal_capacity(vehicle.link.endpoint)
    known = nominal if measure_s > 0 else _smaller(nominal, _remembered(vehicle))
    planned = plan_rates(requested_hz, known)
    try:
        if measure_s <= 0:
            await request.ask(planned)
            return request.report({}, {}, known if planned != dict(requested_hz) else None)
        fitted = await _fitted(request, planned, measure_s)
    except BaseException:
        await asyncio.shield(request.report({}, {}, None).restore())
        raise
    vehicle.carried = None if fitted.carried is None else (fitted.carried, vehicle.clock())
    capacity = known if fitted.carried is None else fitted.carried
    return request.report(fitted.seen.own_hz, fitted.seen.wall_hz, capacity if fitted.rates != requested_hz else None)


@dataclass(frozen=True)
class _Fitted:
    """Rates that fit the link, the arrivals at these rates, and its capacity where that limits them."""

    rates: Mapping[int, float]
    seen: Arrivals
    carried: float | None


async def _fitted(request: _Request, planned: Mapping[int, float], measure_s: float) -> _Fitted:
    """Request the rates; reduce them in steps if the link is too slow, and restore them if that does not help."""
    vehicle, ids = request.vehicle, tuple(planned)
    idle_s = await _answer_s(vehicle, ids, _ASKS_IDLE)
    await request.ask(planned)
    asked_at = vehicle.clock()
    now = _Fitted(planned, await watch(vehicle, ids, measure_s, request.samples(planned)), None)
    if unlimited(vehicle.link.endpoint):
        return now
    late_before = 0.0
    for _ in range(MOST_CUTS):
        late_s = 0.0
        if now.seen.short(now.rates) > SHORT:  # else no answer waits behind samples: they all came at once
            late_s = await _late_s(vehicle, ids, idle_s, asked_at)
        if late_before > 0 and late_s <= _HARDLY * late_before:
            late_s = 0.0  # the buffer that the earlier rates have filled is emptying
        carried = seen_capacity(now.rates, now.seen, late=late_s > 0)
        less = lowered(now.rates, carried)
        if less == now.rates:
            break
        request.hurry(less)
        await request.ask(less)
        asked_at = vehicle.clock()
        relieved = await watch(vehicle, ids, measure_s, request.samples(less))
        late_before = late_s
        enough = relieved.short(less) <= SHORT  # else it is asked for too much still, and answers may be late
        late_s = late_s if enough else 0.0
        if not helped(now.rates, now.seen, less, relieved) or await _late_anyway(vehicle, ids, idle_s, late_s):
            await request.ask(now.rates)
            seen = await watch(vehicle, ids, measure_s, request.samples(now.rates))
            return _Fitted(now.rates, seen, now.carried)
        now = _Fitted(less, relieved, carried)
    return now


def demand_streams(vehicle: Vehicle, requested_hz: Mapping[int, float]) -> Mapping[int, float]:
    """Ask for streams without waiting for answers; returns the rates, lower ones where the link carries less.

    On a link that loses messages it is asked several times: an acknowledgement would take longer.
    """
    planned = plan_rates(requested_hz, _smaller(nominal_capacity(vehicle.link.endpoint), _remembered(vehicle)))
    for message_id, rate in sorted(planned.items(), key=lambda item: item[1]):
        vehicle.rates.requested_us[message_id] = _interval_us(rate)
        vehicle.demand(commands.SET_MESSAGE_INTERVAL, message_id, _interval_us(rate))
    return planned


async def _answer_s(vehicle: Vehicle, message_ids: Sequence[int], asks: int = 1) -> float:
    """Time that the vehicle takes to answer a small request, s: the quickest of `asks` answers."""
    took = []
    for _ in range(asks):
        began = vehicle.clock()
        await get_interval(vehicle, message_ids[0])
        took.append(vehicle.clock() - began)
    return min(took)


async def _late_s(vehicle: Vehicle, message_ids: Sequence[int], idle_s: float, asked_at: float) -> float:
    """How long answers wait behind the streams that were asked for at `asked_at`; 0: no longer than may be chance.

    A small overload takes half a minute to fill a large buffer, which is then never empty again. Every answer then
    takes more than a second. The growing delay shows it within a second.
    """
    late: list[float] = []
    while len(late) < _ASKS:
        since = vehicle.clock() - asked_at
        busy_s = await _answer_s(vehicle, message_ids)
        late.append(busy_s - idle_s)
        if busy_s <= max(LATE_S, LATER * idle_s) and late[-1] <= max(GROWN_S, GROWTH * since):
            return 0.0
    return min(late)


async def _late_anyway(vehicle: Vehicle, message_ids: Sequence[int], idle_s: float, late_s: float) -> bool:
    """True if answers that were late stay as late with fewer samples: it is not the streams that delay them.

    A full buffer takes some answers' time to empty.
    """
    if late_s <= 0:
        return False
    for _ in range(_DRAIN_ASKS):
        if await _answer_s(vehicle, message_ids) - idle_s <= _HARDLY * late_s:
            return False
    return True


def _age_s(vehicle: Vehicle) -> float:
    """Time since the link's capacity was measured, s; infinite if it never was."""
    return math.inf if vehicle.carried is None else vehicle.clock() - vehicle.carried[1]


def _remembered(vehicle: Vehicle) -> float | None:
    """Capacity of the link as measured lately, bytes/s, doubled with each minute since; None: not measured."""
    age = _age_s(vehicle)
    if vehicle.carried is None or age > REMEMBERED_S:
        return None
    return vehicle.carried[0] * float(2.0 ** int(age / FRESH_S))


def _smaller(one: float | None, other: float | None) -> float | None:
    known = [value for value in (one, other) if value is not None]
    return min(known, default=None)


class _Request:
    """The rates requested from a vehicle so far, and its intervals of before."""

    def __init__(self, vehicle: Vehicle, requested_hz: dict[int, float], before: dict[int, int]) -> None:
        self.vehicle = vehicle
        self._requested = requested_hz
        self._previous = before
        self._results: dict[int, int | None] = {}

    def hurry(self, rates_hz: Mapping[int, float]) -> None:
        """Request rates without waiting for answers, which would stand in the queue to be emptied."""
        for message_id, rate in rates_hz.items():
            self.vehicle.rates.requested_us[message_id] = _interval_us(rate)
            self.vehicle.demand(commands.SET_MESSAGE_INTERVAL, message_id, _interval_us(rate))

    async def ask(self, rates_hz: Mapping[int, float]) -> None:
        """Ask for these rates; remember what was before the first time.

        The slow ones first: the link is busy only when the last ones are on, and answers then wait.
        """
        await self.vehicle.rates.followed()
        unknown = [message_id for message_id in rates_hz if message_id not in self._previous]
        if unknown:
            self._previous |= await get_intervals(self.vehicle, unknown)
        slow_first = sorted(rates_hz.items(), key=lambda item: item[1])
        for message_id, rate in slow_first:
            self.vehicle.rates.requested_us[message_id] = _interval_us(rate)
            self._results.setdefault(message_id, None)  # what is cut short is put back too
        self._results |= await set_intervals(self.vehicle, {key: _interval_us(rate) for key, rate in slow_first})

    def samples(self, rates_hz: Mapping[int, float]) -> tuple[int, ...]:
        """The requested streams of samples."""
        refused = [key for key, result in self._results.items() if result not in (commands.ACCEPTED, None)]
        return samples(rates_hz, refused)

    def report(self, own: Mapping[int, float], wall: Mapping[int, float], capacity: float | None) -> StreamReport:
        """The report of everything requested so far."""
        rates = {
            key: StreamRate(key, rate, self._results.get(key), own.get(key, 0.0), wall.get(key, 0.0))
            for key, rate in self._requested.items()
        }
        untouched = {key for key, result in self._results.items() if result not in (commands.ACCEPTED, None)}
        asked = {key: interval for key, interval in self._previous.items() if key in self._results}
        previous = {key: interval for key, interval in asked.items() if key not in untouched}
        return StreamReport(self.vehicle, rates, previous, capacity)


async def follow(vehicle: Vehicle) -> None:
    """Request our rates over the link now in use, and note its earlier ones."""
    ledger, way = vehicle.rates, vehicle.way
    for message_id, interval in dict(ledger.requested_us).items():
        try:
            if not ledger.knows_before(way, message_id):
                ledger.note_before(way, message_id, await get_interval(vehicle, message_id) or DEFAULT_INTERVAL)
            await set_interval(vehicle, message_id, interval)
        except (VehicleError, LinkError):
            continue  # a stream that does not come shows where it is needed


def _is_restored(before_us: int, result: int | None) -> bool:
    """Whether an interval is what it was, by the answer to its request.

    A vehicle that refuses its own default has no such message (HIGHRES_IMU of ArduPilot 4.5): there is none to restore.
    """
    return result == commands.ACCEPTED or (before_us == DEFAULT_INTERVAL and result in commands.REFUSED)


def _interval_us(rate: float) -> float:
    return 1e6 / rate if rate > 0 else -1
