"""Message rates for live views of a vehicle: requested while somebody watches, then restored.

No measurement is disturbed: while a job or a preflight controls a vehicle's rates, or is restoring them, none are
requested here. The next user of the rates first has ours restored (:meth:`LiveRates.release`).
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

import structlog

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.stream.rates import LIVE_MOST_HZ, live_streams
from mavcal.service.errors import Forbidden, ServiceError, VehicleUnknown, WatchUnknown
from mavcal.service.rates.ledger import RateLedgers, request_rates, return_rates
from mavcal.service.rates.owed import OwedRates
from mavcal.service.vehicle.job_vehicle import JobVehicle
from mavcal.service.vehicle.rate_ledger import LiveWatch

log = structlog.get_logger(__name__)

Claim = Callable[[str], str | None]
"""Sentence on what else controls the rates of a vehicle now; None: nothing."""
ARMED = "The vehicle is armed: it is not asked for samples, so that its link stays free. Disarm it to see them."
SILENT = "The vehicle is silent: it is asked for samples once it is heard again."
READ_ONLY = "This service runs with --read-only: it does not change which messages a vehicle sends."


class LiveState(StrEnum):
    """State of a watch."""

    ASKING = "asking"
    GRANTED = "granted"
    """The rates are set; which samples come is seen in the stream."""
    WAITING = "waiting"


@dataclass(frozen=True)
class LiveStatus:
    """How it stands with the rates that a watch wishes for."""

    state: LiveState
    text: str
    """Why samples wait, or come slower than requested; empty: they come as requested."""
    rate_hz: float
    """The fastest rate that anybody who watches this vehicle has requested, Hz."""


@dataclass(frozen=True)
class LiveTimes:
    """Timeouts of watching, s of the wall clock."""

    lapse_s: float = 10.0
    """Time after which a watch ends if its stream takes no samples: the client was killed, or the connection hangs."""
    leave_s: float = 3.0
    """Time that the rates are kept after the end of a stream, for a page that is reloaded."""
    look_s: float = 0.2
    again_s: float = 5.0
    """Time between two attempts after a request or a restore has failed."""
    stop_s: float = 5.0
    """Longest wait of a stopping service for rates to be restored; the rest is restored at its next start."""
    measure_s: float = 2.0
    """Duration of the measurement of the link's rates, by the vehicle's time stamps."""


class LiveRates:
    """The rates of every vehicle that is watched.

    Parameters
    ----------
    ledgers
        Who watches each vehicle, and what is owed to it.
    read_only
        Whether nothing is ever requested from a vehicle.
    times
        See :class:`LiveTimes`.
    clock
        Monotonic, s.
    """

    def __init__(
        self,
        ledgers: RateLedgers,
        *,
        read_only: bool = False,
        times: LiveTimes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ledgers = ledgers
        self._read_only = read_only
        self._times, self._clock = times or LiveTimes(), clock
        self._claim: Claim = lambda _: None
        self._attendants: dict[str, Attendant] = {}
        self._stopping = False

    def start(self, claim: Claim) -> None:
        """Restore what an earlier run has left; from now on `claim` states what else controls a vehicle's rates."""
        self._claim = claim
        if not self._read_only and self._ledgers.kept is not None:
            for vehicle_id in self._ledgers.kept.all():
                self._attend(vehicle_id)

    async def stop(self) -> None:
        """Restore all rates; what cannot be restored within `LiveTimes.stop_s` is restored at the next start."""
        self._stopping = True
        for ledger in self._ledgers.all():
            ledger.watches.clear()
        attendants = tuple(self._attendants.values())
        for one in attendants:
            one.task.cancel()
        await asyncio.gather(*(one.task for one in attendants), return_exceptions=True)
        with suppress(TimeoutError):
            async with asyncio.timeout(self._times.stop_s):
                await asyncio.gather(*(one.release(()) for one in attendants))

    # --- watching

    def begin(self, vehicle_id: str, rate_hz: float) -> LiveWatch:
        """Begin to watch a vehicle; the watch lapses unless a stream takes it up.

        Raises
        ------
        Forbidden
            If this service changes nothing.
        VehicleUnknown
        InvalidInputError
            If the rate is not above zero, or faster than any vehicle streams.
        FirmwareError
            If the autopilot is neither ArduPilot nor PX4.
        """
        if self._read_only:
            raise Forbidden(READ_ONLY)
        if not 0 < rate_hz <= LIVE_MOST_HZ:
            raise InvalidInputError(f"rate_hz is {rate_hz:g}: give a rate above 0, up to {LIVE_MOST_HZ:g} Hz")
        vehicle = self._ledgers.vehicles.vehicle(vehicle_id)
        live_streams(vehicle.identity.autopilot or "", rate_hz)
        watch = LiveWatch(uuid.uuid4().hex[:12], vehicle.id, rate_hz, self._clock() + self._times.lapse_s)
        self._ledgers.of(vehicle.id).watches[watch.id] = watch
        self._attend(vehicle.id)
        return watch

    def watch(self, watch_id: str, vehicle_id: str) -> LiveWatch:
        """The watch of that id. Raises WatchUnknown if it is over, or of another vehicle."""
        found = self._ledgers.of(vehicle_id).watches.get(watch_id)
        if found is None:
            raise WatchUnknown
        return found

    def taken(self, watch: LiveWatch) -> LiveStatus:
        """Note that the stream of this watch has taken samples; returns the state of the rates."""
        watch.until = self._clock() + self._times.lapse_s
        if self._stopping:
            return LiveStatus(LiveState.WAITING, "", watch.rate_hz)
        self._ledgers.of(watch.vehicle_id).watches[watch.id] = watch
        return self._attend(watch.vehicle_id).status

    def left(self, watch: LiveWatch) -> None:
        """Note that the stream of this watch has ended."""
        watch.until = self._clock() + self._times.leave_s

    async def release(self, vehicle_id: str, message_ids: Collection[int]) -> Mapping[int, int]:
        """Restore the rates for a new user, who has claimed the vehicle and needs other ones.

        Returns the original intervals (us, by message) of those of `message_ids` that could not be restored. The caller
        must restore them.
        """
        attendant = self._attendant(vehicle_id)
        return {} if attendant is None else await attendant.release(message_ids)

    # --- inside

    def _attendant(self, vehicle_id: str) -> Attendant | None:
        ledger = self._ledgers.of(vehicle_id)
        going = (one for one in self._attendants.values() if not one.task.done())
        return next((one for one in going if self._ledgers.of(one.vehicle_id) is ledger), None)

    def _attend(self, vehicle_id: str) -> Attendant:
        known = self._attendant(vehicle_id)
        if known is not None:
            return known
        attendant = Attendant(vehicle_id, self._ledgers, self._claim, self._times)
        self._attendants[vehicle_id] = attendant
        attendant.task = asyncio.create_task(attendant.run(self._clock), name=f"live rates of {vehicle_id}")
        attendant.task.add_done_callback(partial(self._over, attendant))
        return attendant

    def _over(self, attendant: Attendant, task: asyncio.Task[None]) -> None:
        if self._attendants.get(attendant.vehicle_id) is attendant:
            del self._attendants[attendant.vehicle_id]
        if not task.cancelled() and task.exception() is not None:
            log.error(
                "live rates are not looked after any more", vehicle=attendant.vehicle_id, exc_info=task.exception()
            )


class WatchOwed:
    """What is owed to one vehicle for its watches, in memory and on the disk; see :class:`service.rates.ledger.Owed`.

    A change is written to disk first, since only that is restored after a crash. It is completed even if the caller is
    cancelled.
    """

    def __init__(self, vehicle_id: str, kept: OwedRates) -> None:
        self._vehicle_id, self._kept = vehicle_id, kept
        self._intervals = dict(kept.all().get(vehicle_id, {}))

    def intervals(self) -> Mapping[int, int]:
        """What is owed."""
        return self._intervals

    async def owe(self, before: Mapping[int, int]) -> None:
        """Add `before` to what is owed, except intervals that are owed already. Raises DiskFull."""
        await self._keep({**before, **self._intervals})

    async def hand_over(self, message_ids: Collection[int]) -> Mapping[int, int]:
        """The owed intervals of these messages, which the caller owes from now on. Raises DiskFull."""
        theirs = {
            message_id: self._intervals[message_id] for message_id in message_ids if message_id in self._intervals
        }
        if theirs:
            await self._keep({key: interval for key, interval in self._intervals.items() if key not in theirs})
        return theirs

    async def returned(self) -> None:
        """Owe nothing any more. Raises DiskFull."""
        await self._keep({})

    async def _keep(self, intervals: Mapping[int, int]) -> None:
        keeping = asyncio.create_task(asyncio.to_thread(self._kept.put, self._vehicle_id, dict(intervals)))
        try:
            await asyncio.shield(keeping)
        finally:
            if not keeping.done():  # a cancellation here would leave memory and disk in disagreement
                await asyncio.wait({keeping})
            if keeping.exception() is None:
                self._intervals = dict(intervals)


class Attendant:
    """Sets the rates of one vehicle that is watched, or returns what is owed to it."""

    task: asyncio.Task[None]

    def __init__(self, vehicle_id: str, ledgers: RateLedgers, claim: Claim, times: LiveTimes) -> None:
        assert ledgers.kept is not None
        self.vehicle_id = vehicle_id
        self.status = LiveStatus(LiveState.ASKING, "", 0.0)
        self._ledgers, self._claim, self._times = ledgers, claim, times
        self._owed = WatchOwed(vehicle_id, ledgers.kept)
        self._requested_hz = 0.0
        self._boots = 0
        self._text = ""
        self._released = False
        self._busy = asyncio.Lock()
        self._requesting: asyncio.Task[None] | None = None

    async def run(self, clock: Callable[[], float]) -> None:
        """Request rates while somebody watches and nothing prevents it, then return them and end."""
        while True:
            rate, pause = self._ledgers.of(self.vehicle_id).wanted_hz(clock()), self._times.look_s
            against = self._obstacle()
            try:
                if self._restarted():
                    self._requested_hz = 0.0
                    await self._owed.returned()  # a vehicle that has restarted has its own rates again
                if rate and against is None and rate != self._requested_hz:
                    self.status = LiveStatus(LiveState.ASKING, "", rate)
                    await self._request(rate)
                elif self._owed.intervals() and self._must_end(rate):
                    await self._return()
                elif not rate and not self._owed.intervals():
                    return
                self._update_status(rate, against)
            except ServiceError as error:
                self.status = LiveStatus(LiveState.WAITING, str(error), rate)
                pause = self._times.again_s
            await asyncio.sleep(pause)

    async def release(self, message_ids: Collection[int]) -> Mapping[int, int]:
        """Return the rates for somebody else; see :meth:`LiveRates.release`."""
        self._released = True
        if self._requesting is not None:
            self._requesting.cancel()
        with suppress(ServiceError):
            await self._return()
        return await self._owed.hand_over(message_ids)

    def _update_status(self, rate: float, against: str | None) -> None:
        if rate and self._requested_hz == rate:
            self.status = LiveStatus(LiveState.GRANTED, self._text, rate)
        elif rate and against is not None:
            self.status = LiveStatus(LiveState.WAITING, against, rate)

    def _vehicle(self) -> JobVehicle | None:
        try:
            return self._ledgers.vehicles.vehicle(self.vehicle_id)
        except VehicleUnknown:
            return None

    def _obstacle(self) -> str | None:
        """Reason to request nothing of the vehicle now; None: requests may go out."""
        vehicle = self._vehicle()
        if vehicle is None:
            return SILENT
        now = vehicle.condition()
        if now.silent:
            return SILENT
        if now.armed:
            return ARMED
        return now.conflict or self._claim(vehicle.id)

    def _must_end(self, rate: float) -> bool:
        """Whether nobody watches any more, or a flight needs the link; False while another user has the vehicle."""
        vehicle = self._vehicle()
        if vehicle is None or (self._released and self._claim(vehicle.id) is not None):
            return False
        return not rate or vehicle.condition().armed

    def _restarted(self) -> bool:
        vehicle = self._vehicle()
        return vehicle is not None and self._requested_hz > 0 and vehicle.condition().reboots > self._boots

    async def _request(self, rate: float) -> None:
        """Request rates; a new user of the vehicle cancels this, and the rates already set are then restored."""
        self._requesting = asyncio.create_task(self._set(rate), name=f"live rates requested of {self.vehicle_id}")
        try:
            await asyncio.wait({self._requesting})
        finally:
            self._requesting.cancel()
            result = (await asyncio.gather(self._requesting, return_exceptions=True))[0]
            self._requesting = None
        if isinstance(result, Exception):
            raise result

    async def _set(self, rate: float) -> None:
        async with self._busy:
            vehicle = self._ledgers.vehicles.vehicle(self.vehicle_id)
            rates = live_streams(vehicle.identity.autopilot or "", rate)
            self._boots, self._released = vehicle.condition().reboots, False
            slow = await request_rates(vehicle, rates, self._owed, measure_s=self._times.measure_s)
            self._requested_hz = rate
            self._text = f"The link is slow: fewer samples come than {rate:g} a second." if slow else ""

    async def _return(self) -> None:
        """Return the rates. Raises VehicleError, LinkError, DiskFull unless every interval is confirmed."""
        async with self._busy:
            self._requested_hz = 0.0
            vehicle = self._vehicle()
            if vehicle is None:
                return
            now = vehicle.condition()
            if not now.silent and now.conflict is None:
                await return_rates(vehicle, self._owed)
