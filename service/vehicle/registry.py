"""All vehicles on all links."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message, decode
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import LinkDown, VehicleError, VehicleUnknown
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkEvent
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.heard import CORE_IDS
from mavcal.service.vehicle.kin import Kin
from mavcal.service.vehicle.streams import follow
from mavcal.service.vehicle.vehicle import YIELD_S, Vehicle

TICK_S = 0.05
"""Tick period of a vehicle while an answer from it is awaited, s."""
IDLE_TURNS = 5
IDLE_S = IDLE_TURNS * TICK_S
"""Tick period of any other vehicle, s, for silence and old states. It is measured by the clock, since a late event loop
has few turns."""
TOGETHER = 50
"""Number of vehicles ticked in one go; the event loop does its other work in between."""
_AUTOPILOT_COMPONENT = 1
_IDENTIFY_AGAIN_S = 10.0

VehicleCallback = Callable[[VehicleEvent], None]


class VehicleRegistry:
    """Finds vehicles on the links it is attached to, names them and keeps them informed.

    A vehicle is whoever sends HEARTBEAT as component 1 with an autopilot; ground stations and companions are not.

    Parameters
    ----------
    clock
        Monotonic time in seconds.
    yield_s
        A unit that was not heard for so long gives way to another one with its system id; at least 10 s.
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic, yield_s: float = YIELD_S) -> None:
        self._clock = clock
        self._yield_s = yield_s
        self._vehicles: dict[tuple[str, int, int], Vehicle] = {}
        self._detachers: dict[str, list[Callable[[], None]]] = {}
        self._subscribers: dict[object, VehicleCallback] = {}
        self._identifying: dict[Vehicle, asyncio.Task[None]] = {}
        self._kin = Kin(clock)
        self._ticker: asyncio.TimerHandle | None = None
        self._turns: list[tuple[int, tuple[str, int, int]]] = []
        """Vehicles still to be ticked in this round, numbered."""
        self._period: dict[tuple[str, int, int], int] = {}
        """In which of its periods of :data:`IDLE_S` each vehicle had its last turn; they begin at different times."""

    # --- links ------------------------------------------------------------------------------------------------------

    def attach(self, link: Link) -> None:
        """Find vehicles on this link; best called before it is opened."""
        key = link.id
        self._detachers[key] = [
            link.subscribe(lambda batch: self._take(link, batch), CORE_IDS),
            link.subscribe_events(lambda event: self._link_event(link, event)),
        ]
        if self._ticker is None:
            self._tick()

    def detach(self, link: Link) -> None:
        """Forget this link. A vehicle that is heard on no other one is forgotten too: what waits for it ends with
        LinkDown.
        """
        for detach in self._detachers.pop(link.id, []):
            detach()
        for key, vehicle in list(self._vehicles.items()):
            if key[0] != link.id:
                continue
            del self._vehicles[key]
            self._period.pop(key, None)
            if len(vehicle.channels) > 1:
                vehicle.leave(link, "the link was closed")
            else:
                self._stop_identifying(vehicle)
                vehicle.close(LinkDown(f"Link {link.id} was closed."))
        for vehicle in self._units():
            if not vehicle.settled:
                self._settle(vehicle)
        if not self._detachers and self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    def close(self) -> None:
        """Detach from every link; closes none of them."""
        for link in {link for vehicle in self._vehicles.values() for link in vehicle.links}:
            self.detach(link)
        for detachers in self._detachers.values():
            for detach in detachers:
                detach()
        self._detachers.clear()
        self._kin.close()
        if self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    # --- vehicles ---------------------------------------------------------------------------------------------------

    def all(self) -> tuple[Vehicle, ...]:
        """Every unit heard, in the order of discovery.

        A unit that may be one already known is left out until that is decided.
        """
        return tuple(vehicle for vehicle in self._units() if not vehicle.undecided)

    def _units(self) -> tuple[Vehicle, ...]:
        return tuple(dict.fromkeys(self._vehicles.values()))

    def get(self, vehicle_id: str) -> Vehicle:
        """The vehicle of that id, or of an id ``<link>-<system>-<component>`` that one of its links gives it.

        Raises
        ------
        VehicleUnknown
            If there is none.
        """
        units = self._units()
        for vehicle in units:
            if vehicle_id == vehicle.id:
                return vehicle
        for vehicle in units:
            if vehicle_id in (place(link, vehicle) for link in vehicle.links):
                return vehicle
        heard = ", ".join(vehicle.id for vehicle in units) or "none"
        raise VehicleUnknown(f"There is no vehicle {vehicle_id}; heard so far: {heard}.")

    def subscribe(self, callback: VehicleCallback) -> Callable[[], None]:
        """Hand every event of every vehicle to `callback`, until the function returned here is called."""
        key = object()
        self._subscribers[key] = callback

        def unsubscribe() -> None:
            self._subscribers.pop(key, None)

        return unsubscribe

    # --- inside -----------------------------------------------------------------------------------------------------

    def _take(self, link: Link, batch: Batch) -> None:
        senders: dict[tuple[int, int], list[Frame]] = {}
        for frame in batch.frames:
            senders.setdefault((frame.system, frame.component), []).append(frame)
        for (system, component), frames in senders.items():
            vehicle = self._vehicles.get((link.id, system, component))
            if vehicle is None and component == _AUTOPILOT_COMPONENT:
                vehicle = self._find(link, frames)
            if vehicle is not None:
                vehicle.feed(frames, batch, link)
                if vehicle.successor is not None:
                    vehicle = self._replace(vehicle)
                    vehicle.feed(frames, batch, link)
                elif vehicle.channels.of(link).stranger is not None:
                    vehicle = self._part(vehicle, link, "another unit answers there")
                    vehicle.feed(frames, batch, link)
                if not vehicle.settled:
                    self._settle(vehicle)

    def _find(self, link: Link, frames: list[Frame]) -> Vehicle | None:
        for frame in frames:
            if frame.message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                heartbeat = decode(frame)
                if is_vehicle(heartbeat):
                    return self._add(link, frame.system, frame.component, heartbeat)
        return None

    def _add(self, link: Link, system: int, component: int, heartbeat: Message) -> Vehicle:
        vehicle = Vehicle(
            link, system, component, heartbeat, clock=self._clock, announce=self._announce, yield_s=self._yield_s
        )
        self._vehicles[link.id, system, component] = vehicle
        self._announce(vehicle, VehicleEventKind.FOUND, f"Heard {vehicle.id}.")
        self._identify(vehicle)
        return vehicle

    def _replace(self, gone: Vehicle) -> Vehicle:
        """Another unit has the address of one that is gone: it gets its own state, parameters and jobs."""
        self._stop_identifying(gone)
        self._announce(gone, VehicleEventKind.REPLACED, gone.mark_replaced())
        return self._add(gone.link, gone.system, gone.component, gone.heartbeat)

    def _part(self, unit: Vehicle, link: Link, why: str) -> Vehicle:
        """Split off the unit on this link, which is not the one on the other links, as a vehicle of its own."""
        heartbeat = unit.heartbeat
        unit.leave(link, why)
        return self._add(link, unit.system, unit.component, heartbeat)

    def _settle(self, vehicle: Vehicle) -> None:
        """Decide which unit this is, as far as that is known (decision 44)."""
        address = (vehicle.system, vehicle.component)
        units = [self._vehicles[link, *address] for link in self._detachers if (link, *address) in self._vehicles]
        decided = self._kin.decide(vehicle, units)
        if decided is None:
            return
        vehicle.settled = True
        was, vehicle.undecided = vehicle.undecided, ""
        if decided is not vehicle:
            self._stop_identifying(vehicle)
            for key, known in self._vehicles.items():
                if known is vehicle:
                    self._vehicles[key] = decided
            decided.join(vehicle)
        elif was and vehicle.identity.known:
            self._announce(vehicle, VehicleEventKind.IDENTIFIED, f"A vehicle of its own: {was}")

    def _link_event(self, link: Link, event: LinkEvent) -> None:
        for vehicle in self._units():
            if link in vehicle.links:
                vehicle.link_event(event)

    def _tick(self) -> None:
        """Let time pass for some vehicles; all of them have had their turn after :data:`TICK_S`."""
        parts = max(1, -(-len(self._vehicles) // TOGETHER))
        self._ticker = asyncio.get_running_loop().call_later(TICK_S / parts, self._tick)
        if not self._turns:
            self._turns = list(enumerate(self._vehicles))
        some, self._turns = self._turns[:TOGETHER], self._turns[TOGETHER:]
        now = self._clock()
        for number, place in some:
            vehicle = self._vehicles.get(place)
            period = int((now + TICK_S * (number % IDLE_TURNS)) / IDLE_S)
            if vehicle is not None and (vehicle.waits.any or period != self._period.get(place)):
                self._period[place] = period
                vehicle.tick()
                if not vehicle.settled:
                    self._settle(vehicle)
                for channel in self._kin.apart(vehicle):
                    self._part(vehicle, channel.link, "its clock is another one's")

    def _announce(self, vehicle: Vehicle, kind: VehicleEventKind, text: str) -> None:
        if kind is VehicleEventKind.IDENTIFIED:
            vehicle.id = self._name(vehicle)
        elif kind is VehicleEventKind.REBOOTED:
            self._identify(vehicle)
        elif kind is VehicleEventKind.HEARD_AGAIN and vehicle.identity.uid2 is None:
            vehicle.decide_again()  # it may have been found on another link meanwhile, as nobody known
        elif kind is VehicleEventKind.MOVED:
            vehicle.rates.begin_following(partial(follow, vehicle))
        event = VehicleEvent(kind, vehicle.id, text)
        loop = asyncio.get_running_loop()
        for key in list(self._subscribers):
            loop.call_soon(self._hand_event, key, event)

    def _hand_event(self, key: object, event: VehicleEvent) -> None:
        callback = self._subscribers.get(key)
        if callback is not None:
            callback(event)

    def _name(self, vehicle: Vehicle) -> str:
        """Id from the unique id; by place if there is none, or if another vehicle has the same."""
        uid2 = vehicle.identity.uid2
        if uid2 is None:
            return vehicle.id
        name = f"uid-{uid2}"
        taken = any(other is not vehicle and other.id == name for other in self._units())
        return place(vehicle.link, vehicle) if taken else name

    def _identify(self, vehicle: Vehicle) -> None:
        self._stop_identifying(vehicle)
        task = asyncio.get_running_loop().create_task(self._ask_who(vehicle))
        self._identifying[vehicle] = task
        task.add_done_callback(lambda done: self._identified(vehicle, done))

    def _identified(self, vehicle: Vehicle, task: asyncio.Task[Any]) -> None:
        if self._identifying.get(vehicle) is task:
            del self._identifying[vehicle]
        if not task.cancelled():
            task.result()

    def _stop_identifying(self, vehicle: Vehicle) -> None:
        task = self._identifying.pop(vehicle, None)
        if task is not None:
            task.cancel()

    async def _ask_who(self, vehicle: Vehicle) -> None:
        """Ask for the vehicle's identity until it answers; it may still be starting, or have a bad link."""
        while True:
            try:
                await vehicle.identify()
            except (VehicleError, LinkDown):
                await asyncio.sleep(_IDENTIFY_AGAIN_S)
            else:
                return


def is_vehicle(heartbeat: Any) -> bool:
    """True for the HEARTBEAT of an autopilot; ground stations, gimbals and companions have none."""
    return bool(heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type != dialect.MAV_TYPE_GCS)


def place(link: Link, vehicle: Vehicle) -> str:
    """The id that a vehicle without a unique one has from the link on which it was found."""
    return f"{link.id}-{vehicle.system}-{vehicle.component}"
