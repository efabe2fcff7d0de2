"""Message rates for those who watch a vehicle: requested while somebody does, then put back as they were.

No measurement is disturbed. While a job or a preflight controls the rates of a vehicle, or still puts them back, none
are requested here. Whoever needs them next has ours put back first (:meth:`LiveRates.give_way`).
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
from mavcal.service.rates.owed import OwedRates
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource

log = structlog.get_logger(__name__)

Claim = Callable[[str], str | None]
"""What else has the rates of a vehicle now, in a sentence; None: nothing."""


ARMED = "The vehicle is armed: it is not asked for samples, so that its link stays free. Disarm it to see them."


SILENT = "The vehicle is silent: it is asked for samples once it is heard again."


READ_ONLY = "This service runs with --read-only: it does not change which messages a vehicle sends."


class LiveState(StrEnum):
    """What has become of the wish to watch."""

    ASKING = "asking"
    GRANTED = "granted"
    """The rates are set; which samples come is seen in the stream."""
    WAITING = "waiting"


@dataclass(frozen=True)
class LiveStatus:
    """How it stands with the rates of a vehicle that is watched.

    Parameters
    ----------
    state
        What has become of the wish.
    text
        Why samples wait, or come slower than requested; empty: they come as requested.
    rate_hz
        The fastest rate that anybody who watches this vehicle has requested.
    """

    state: LiveState
    text: str
    rate_hz: float


@dataclass
class LiveWatch:
    """The wish of one client; it lapses unless its stream goes on taking samples."""

    id: str
    vehicle_id: str
    rate_hz: float
    until: float


@dataclass(frozen=True)
class LiveTimes:
    """Times of watching, s of the wall clock."""

    lapse_s: float = 10.0
    """A watch whose stream takes nothing for so long is over: its client was killed, or its connection hangs."""
    leave_s: float = 3.0
    """After the end of its stream: a page that is loaded again finds the rates as they are."""
    look_s: float = 0.2
    again_s: float = 5.0
    """Between two attempts, where asking or putting back has failed."""
    stop_s: float = 5.0
    """So long a service that stops waits for rates to be put back; what is left is done at its next start."""
    measure_s: float = 2.0
    """How long it is measured what the link carries, by the vehicle's time stamps."""


class LiveRates:
    """The rates of every vehicle that is watched.

    Parameters
    ----------
    vehicles
        Where vehicles are found.
    owed
        What has to be put back.
    read_only
        No vehicle is ever asked for anything.
    times
        See there.
    clock
        Monotonic, s.
    """

    def __init__(
        self,
        vehicles: VehicleSource,
        owed: OwedRates,
        *,
        read_only: bool = False,
        times: LiveTimes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._vehicles, self._owed = vehicles, owed
        self._read_only = read_only
        self._times, self._clock = times or LiveTimes(), clock
        self._claim: Claim = lambda _: None
        self._watches: dict[str, LiveWatch] = {}
        self._attended: dict[str, _Attended] = {}
        self._stopping = False

    def start(self, claim: Claim) -> None:
        """Put back what an earlier run has left; `claim` says from now on what else has the rates of a vehicle."""
        self._claim = claim
        if not self._read_only:
            for vehicle_id in self._owed.all():
                self._attend(vehicle_id)

    async def stop(self) -> None:
        """Put everything back; what cannot be within a while is put back at the next start."""
        self._stopping = True
        self._watches.clear()
        attended = tuple(self._attended.values())
        for one in attended:
            one.task.cancel()
        await asyncio.gather(*(one.task for one in attended), return_exceptions=True)
        with suppress(TimeoutError):
            async with asyncio.timeout(self._times.stop_s):
                await asyncio.gather(*(one.give_way(()) for one in attended))

    # --- watching

    def begin(self, vehicle_id: str, rate_hz: float) -> LiveWatch:
        """Wish for the samples of a vehicle; the watch has to be taken up by a stream.

        Raises
        ------
        Forbidden
            If this service changes nothing.
        VehicleUnknown
        InvalidInputError
            If nobody streams as fast, or the rate is none.
        FirmwareError
            If the autopilot is neither ArduPilot nor PX4.
        """
        if self._read_only:
            raise Forbidden(READ_ONLY)
        if not 0 < rate_hz <= LIVE_MOST_HZ:
            raise InvalidInputError(f"rate_hz is {rate_hz:g}: give a rate above 0, up to {LIVE_MOST_HZ:g} Hz")
        vehicle = self._vehicles.vehicle(vehicle_id)
        live_streams(vehicle.identity.autopilot or "", rate_hz)
        watch = LiveWatch(uuid.uuid4().hex[:12], vehicle.id, rate_hz, self._clock() + self._times.lapse_s)
        self._watches[watch.id] = watch
        self._attend(vehicle.id)
        return watch

    def watch(self, watch_id: str, vehicle_id: str) -> LiveWatch:
        """The watch of that id. Raises WatchUnknown if it is over, or of another vehicle."""
        found = self._watches.get(watch_id)
        if found is None or self._place(found.vehicle_id) != self._place(vehicle_id):
            raise WatchUnknown
        return found

    def taken(self, watch: LiveWatch) -> LiveStatus:
        """The stream of this watch has taken samples: it goes on. How it stands with the rates."""
        watch.until = self._clock() + self._times.lapse_s
        if self._stopping:
            return LiveStatus(LiveState.WAITING, "", watch.rate_hz)
        self._watches[watch.id] = watch
        return self._attend(watch.vehicle_id).status

    def left(self, watch: LiveWatch) -> None:
        """The stream of this watch has ended."""
        watch.until = self._clock() + self._times.leave_s

    async def give_way(self, vehicle_id: str, message_ids: Collection[int]) -> Mapping[int, int]:
        """Put our rates back, for somebody who has claimed the vehicle and needs other ones.

        Returns intervals (us, by message) that could not be put back, of those that are asked about: they are how it
        was before us, and putting them back is the caller's from now on.
        """
        attended = self._find(vehicle_id)
        return {} if attended is None else await attended.give_way(message_ids)

    def wished_hz(self, vehicle_id: str) -> float:
        """The fastest rate that anybody wishes; 0: nobody watches. Watches that have lapsed are forgotten."""
        now = self._clock()
        for watch in [watch for watch in self._watches.values() if watch.until <= now]:
            del self._watches[watch.id]
        place = self._place(vehicle_id)
        return max((w.rate_hz for w in self._watches.values() if self._place(w.vehicle_id) == place), default=0.0)

    # --- inside

    def _place(self, vehicle_id: str) -> str:
        """A vehicle gets its lasting id when it has said which unit it is, and is found by the first one still."""
        try:
            return self._vehicles.vehicle(vehicle_id).id
        except VehicleUnknown:
            return vehicle_id

    def _find(self, vehicle_id: str) -> _Attended | None:
        place = self._place(vehicle_id)
        going = (attended for attended in self._attended.values() if not attended.task.done())
        return next((attended for attended in going if self._place(attended.vehicle_id) == place), None)

    def _attend(self, vehicle_id: str) -> _Attended:
        known = self._find(vehicle_id)
        if known is not None:
            return known
        attended = _Attended(vehicle_id, self._vehicles, self._owed, self._claim, self._times)
        self._attended[vehicle_id] = attended
        attended.task = asyncio.create_task(
            attended.run(partial(self.wished_hz, vehicle_id)), name=f"live rates of {vehicle_id}"
        )
        attended.task.add_done_callback(partial(self._over, attended))
        return attended

    def _over(self, attended: _Attended, task: asyncio.Task[None]) -> None:
        if self._attended.get(attended.vehicle_id) is attended:
            del self._attended[attended.vehicle_id]
        if not task.cancelled() and task.exception() is not None:
            log.error(
                "live rates are not looked after any more", vehicle=attended.vehicle_id, exc_info=task.exception()
            )


class _Attended:
    """One vehicle that is watched, or to which rates are owed."""

    task: asyncio.Task[None]

    def __init__(
        self, vehicle_id: str, vehicles: VehicleSource, kept: OwedRates, claim: Claim, times: LiveTimes
    ) -> None:
        self.vehicle_id = vehicle_id
        self.status = LiveStatus(LiveState.ASKING, "", 0.0)
        self._vehicles, self._kept, self._claim, self._times = vehicles, kept, claim, times
        self._owed = dict(kept.all().get(vehicle_id, {}))
        self._asked_hz = 0.0
        self._boots = 0
        self._text = ""
        self._gave_way = False
        self._busy = asyncio.Lock()
        self._asking: asyncio.Task[None] | None = None

    async def run(self, wished: Callable[[], float]) -> None:
        """Ask while somebody wishes for it and nothing stands against it; then put back. Returns when that is done."""
        while True:
            rate, pause = wished(), self._times.look_s
            against = self._against()
            try:
                if self._restarted():
                    self._asked_hz = 0.0
                    await self._owe({})  # a vehicle that has restarted has its own rates again
                if rate and against is None and rate != self._asked_hz:
                    self.status = LiveStatus(LiveState.ASKING, "", rate)
                    await self._ask(rate)
                elif self._owed and self._must_end(rate):
                    await self._put_back()
                elif not rate and not self._owed:
                    return
                self._tell(rate, against)
            except ServiceError as error:
                self.status = LiveStatus(LiveState.WAITING, str(error), rate)
                pause = self._times.again_s
            await asyncio.sleep(pause)

    async def give_way(self, message_ids: Collection[int]) -> Mapping[int, int]:
        """See :meth:`LiveRates.give_way`."""
        self._gave_way = True
        if self._asking is not None:
            self._asking.cancel()
        with suppress(ServiceError):
            await self._put_back()
        left = {message_id: self._owed[message_id] for message_id in message_ids if message_id in self._owed}
        if left:
            await self._owe({key: interval for key, interval in self._owed.items() if key not in left})
        return left

    def _tell(self, rate: float, against: str | None) -> None:
        if rate and self._asked_hz == rate:
            self.status = LiveStatus(LiveState.GRANTED, self._text, rate)
        elif rate and against is not None:
            self.status = LiveStatus(LiveState.WAITING, against, rate)

    def _vehicle(self) -> JobVehicle | None:
        try:
            return self._vehicles.vehicle(self.vehicle_id)
        except VehicleUnknown:
            return None

    def _against(self) -> str | None:
        """Why nothing is asked of the vehicle now."""
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
        """Whether nobody watches any more, or a flight needs the link.

        Not while somebody for whom we gave way has rates of its own.
        """
        vehicle = self._vehicle()
        if vehicle is None or (self._gave_way and self._claim(vehicle.id) is not None):
            return False
        return not rate or vehicle.condition().armed

    def _restarted(self) -> bool:
        vehicle = self._vehicle()
        return vehicle is not None and self._asked_hz > 0 and vehicle.condition().reboots > self._boots

    async def _ask(self, rate: float) -> None:
        self._asking = asyncio.create_task(self._asked(rate), name=f"live rates asked of {self.vehicle_id}")
        try:
            await asyncio.wait({self._asking})
        finally:
            self._asking.cancel()
            result = (await asyncio.gather(self._asking, return_exceptions=True))[0]
            self._asking = None
        if isinstance(result, Exception):
            raise result

    async def _asked(self, rate: float) -> None:
        """Cancelled by whoever needs the vehicle: what was set is put back then."""
        async with self._busy:
            vehicle = self._vehicles.vehicle(self.vehicle_id)
            rates = live_streams(vehicle.identity.autopilot or "", rate)
            self._boots, self._gave_way = vehicle.condition().reboots, False
            before = await vehicle.intervals([key for key in rates if key not in self._owed])
            await self._owe({**before, **self._owed})
            slow = await vehicle.request_streams(rates, measure_s=self._times.measure_s, before=self._owed)
            self._asked_hz = rate
            self._text = f"The link is slow: fewer samples come than {rate:g} a second." if slow else ""

    async def _put_back(self) -> None:
        """Raises VehicleError, LinkError, DiskFull if it is not certain that everything is as before."""
        async with self._busy:
            self._asked_hz = 0.0
            vehicle = self._vehicle()
            if not self._owed or vehicle is None:
                return
            now = vehicle.condition()
            if not now.silent and now.conflict is None:
                await vehicle.set_intervals(self._owed)
                await self._owe({})

    async def _owe(self, intervals: Mapping[int, int]) -> None:
        """The disk first: what is not kept there would not be put back after a crash. Whole, if it is cancelled."""
        keeping = asyncio.create_task(asyncio.to_thread(self._kept.put, self.vehicle_id, dict(intervals)))
        try:
            await asyncio.shield(keeping)
        finally:
            await asyncio.wait({keeping})
            if keeping.exception() is None:
                self._owed = dict(intervals)
