"""The preconditions of every write (DESIGN 6, rules 1 to 3), checked also while an answer is awaited."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

from mavcal.service.errors import (
    LeaseLost,
    LinkDown,
    ServiceError,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleSilent,
    WriteStopped,
)
from mavcal.service.vehicle.job_vehicle import Condition, JobVehicle

T = TypeVar("T")
HEARTBEAT, EXTENDED_SYS_STATE, MAG_CAL_PROGRESS = 0, 245, 191
_TELLING = frozenset({HEARTBEAT, EXTENDED_SYS_STATE, MAG_CAL_PROGRESS})
"""Messages that can show at once that a write has to stop."""
STOPPING = (WriteStopped, VehicleArmed, VehicleBusy, VehicleConflict, VehicleSilent, LinkDown, LeaseLost)
"""Errors after which nothing more may be sent, not even to undo a change."""
RESTARTED = "the vehicle restarted by itself"


class WriteGuard:
    """Stops whatever runs under it as soon as the vehicle may not be written to.

    When set up, it stores the vehicle's identity and its counts of restarts, armings, silences and calibrations. Events
    that came and went while the event loop was busy therefore stop a write too.
    """

    def __init__(self, vehicle: JobVehicle, watch_s: float) -> None:
        self._vehicle = vehicle
        self._watch_s = watch_s
        self._uid = vehicle.identity.uid
        self._before = vehicle.condition()
        self._peers = {self._before.way: self._before.peer}
        """The address on each link, as it was when that came into use."""

    def reason(self) -> str | None:
        """Reason that forbids a write now; None: a write may begin."""
        now = self._vehicle.condition()
        # The cause comes before its consequences: a vehicle that restarted is silent for a while, calibrates, is not
        # known to be on the ground, and may speak from another port.
        before = self._before
        if now.conflict is not None:
            return now.conflict
        if self._vehicle.identity.uid != self._uid:
            return "another vehicle answers under this one's address"
        if now.reboots != before.reboots:
            return RESTARTED
        if now.silent:
            return "the vehicle fell silent"
        if now.armed:
            return "the vehicle is armed"
        if self._elsewhere(now):
            return f"the vehicle speaks from another address ({self._peers[now.way]}, now {now.peer})"
        if now.calibrating:
            return "the vehicle runs a calibration of its own"
        return self._meanwhile(now) or "; ".join(now.obstacles) or None

    def _elsewhere(self, now: Condition) -> bool:
        """Whether it sends from another address on the same link; another link is merely another way to the unit."""
        return self._peers.setdefault(now.way, now.peer) != now.peer

    def _meanwhile(self, now: Condition) -> str | None:
        """Why nothing may be written, from events that came and went since the guard was set up."""
        before = self._before
        if now.armings != before.armings:
            return "the vehicle was armed meanwhile"
        if now.silences != before.silences:
            return "the vehicle was silent meanwhile"
        return "the vehicle ran a calibration of its own meanwhile" if now.calibrations != before.calibrations else None

    @property
    def restarted(self) -> bool:
        """Whether the vehicle has restarted, not by us."""
        return self._vehicle.condition().reboots != self._before.reboots

    @property
    def silent(self) -> bool:
        """Whether the vehicle is silent now."""
        return self._vehicle.condition().silent

    def doubt(self) -> str | None:
        """Why confirmed values may have changed since they were read; None: no reason is known."""
        now = self._vehicle.condition()
        before = self._before
        if now.reboots != before.reboots:
            return "before the vehicle restarted"
        if now.conflict is not None or self._elsewhere(now) or self._vehicle.identity.uid != self._uid:
            return "possibly said by another vehicle"
        silent = now.silent or now.silences != before.silences
        return "before the vehicle fell silent" if silent else None

    def check(self) -> None:
        """Raise WriteStopped if nothing may be written now."""
        reason = self.reason()
        if reason is not None:
            raise WriteStopped(reason)

    def expect_restart(self) -> None:
        """Expect a restart: the state after it becomes the reference."""
        self._before = self._vehicle.condition()
        self._peers = {self._before.way: self._before.peer}

    async def run(self, act: Callable[[], Awaitable[T]]) -> T:
        """Await ``act()`` and abandon it as soon as the preconditions fail.

        Raises
        ------
        WriteStopped
            Before the start or in the middle. What was sent may still have an effect.
        """
        await self._vehicle.caught_up()
        self.check()
        news = asyncio.Event()
        unsubscribe = self._vehicle.subscribe(_TELLING, lambda _frames, _error: news.set())
        task = asyncio.ensure_future(act())
        try:
            while not task.done():
                news.clear()
                waker = asyncio.ensure_future(news.wait())
                try:
                    await asyncio.wait({task, waker}, timeout=self._watch_s, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    waker.cancel()
                if not task.done():
                    self.check()
            return task.result()
        finally:
            unsubscribe()
            if not task.done():
                task.cancel()
                with suppress(asyncio.CancelledError, ServiceError):
                    await task
