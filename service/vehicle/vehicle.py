"""One vehicle: its identity, its state, and everything that is sent to it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NoReturn

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire import Frame, Message, RawMessage, decode
from mavcal.service.errors import (
    CommandTimeout,
    LinkDown,
    ServiceError,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleError,
    VehicleSilent,
)
from mavcal.service.link import Batch, Link, LinkEvent, LinkEventKind, OwnIdentity
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.boot_time import BOOT_TIME_IDS, boot_time
from mavcal.service.vehicle.events import VehicleEventKind
from mavcal.service.vehicle.identity import VehicleIdentity, identity_from_heartbeat, identity_from_version
from mavcal.service.vehicle.listing import ParameterSet, Progress, list_all
from mavcal.service.vehicle.pace import Pace
from mavcal.service.vehicle.parameters import Parameters
from mavcal.service.vehicle.state import (
    Refusal,
    VehicleState,
    Writable,
    changed,
    expire,
    note_boot_time,
    reduce,
    writable,
)
from mavcal.service.vehicle.waits import Waits

VERSION_ID = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
STATE_IDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        dialect.MAVLINK_MSG_ID_VFR_HUD,
        dialect.MAVLINK_MSG_ID_STATUSTEXT,
        dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS,
        dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT,
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
    }
)
"""Messages that make the state."""
_CLOCK_IDS = frozenset({dialect.MAVLINK_MSG_ID_SYSTEM_TIME, dialect.MAVLINK_MSG_ID_ATTITUDE})
CORE_IDS = (
    STATE_IDS
    | _CLOCK_IDS
    | {
        VERSION_ID,
        dialect.MAVLINK_MSG_ID_PARAM_VALUE,
        dialect.MAVLINK_MSG_ID_PARAM_ERROR,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL,
    }
)
"""Messages that every vehicle needs of its link."""

CONFLICT_S = 30.0
"""A doubt about who is being talked to holds for so long after its last sign."""
YIELD_S = 30.0
"""A unit that has not said who it is for so long gives way to another one that answers to its system id.

It is asked every 5 s: as long as both are there, both answer, and that stays a conflict."""
_POLL_S = 2.0
_WHO_S = 5.0
_MARK_S = 5.0
_SECOND_ANSWER_S = 0.3
_IDENTIFY_TRIES = 5


FramesCallback = Callable[[Sequence[Frame], Batch], None]
Announce = Callable[["Vehicle", VehicleEventKind, str], None]
"""Told which vehicle, what happened to it, and the same in a sentence."""


class Vehicle:
    """A vehicle on a link, addressed by (system, component). Everything is called from the event loop.

    ``state`` is a snapshot that is replaced, never changed; ``parameters`` is what was heard of them last.
    """

    def __init__(
        self,
        link: Link,
        system: int,
        component: int,
        heartbeat: Message,
        *,
        clock: Callable[[], float],
        announce: Announce,
        yield_s: float = YIELD_S,
    ) -> None:
        self.link = link
        self.system = system
        self.component = component
        self.clock = clock
        self.id = f"{link.id}-{system}-{component}"
        """Stable and URL-safe; the registry makes it from the unique id once that is known."""
        self.identity: VehicleIdentity = identity_from_heartbeat(heartbeat)
        self.state = VehicleState()
        self.waits = Waits(clock)
        self.pace = Pace()
        """How fast it answers."""
        self.parameters = Parameters(self)
        self.listed = False
        """Whether every parameter was listed since the vehicle started: some are heard without being asked for."""
        self.carried: tuple[float, float] | None = None
        """Bytes per second that the link was seen to carry when more was asked of it, and when; None: never seen."""
        self._announce = announce
        self._listing_lock = asyncio.Lock()
        self._command_locks: dict[int, asyncio.Lock] = {}
        self._subscribers: dict[object, tuple[frozenset[int], FramesCallback, Callable[[], None]]] = {}
        self._conflicts: dict[str, tuple[str, float]] = {}
        self._silent = False
        self._clock_heard = False
        self._polled_at = self._asked_who_at = -1e9
        self._yield_s = yield_s
        self._stated_at = clock()
        self._replaced = ""
        self.heartbeat = heartbeat
        """The last one heard at this address, be it of another unit."""
        self.successor: str | None = None
        """Unique id of another unit that answers here now, while this one has been gone for long enough."""

    # --- talking ----------------------------------------------------------------------------------------------------

    @property
    def own(self) -> OwnIdentity:
        """The ids that it is spoken to with."""
        return self.link.ids

    def send(self, message: Message | RawMessage) -> None:
        """Send to this vehicle. Raises LinkDown if that is not possible."""
        self.link.send(message, (self.system, self.component))

    async def command(
        self,
        command_id: int,
        params: Sequence[float] = (),
        *,
        timeout: float = 1.5,  # noqa: ASYNC109 - see commands.command
        retries: int = 2,
    ) -> None:
        """See :func:`service.vehicle.commands.command`."""
        await commands.command(self, command_id, params, timeout=timeout, retries=retries)

    def command_lock(self, command_id: int) -> asyncio.Lock:
        """An acknowledgement names only the command: one of a kind at a time."""
        return self._command_locks.setdefault(command_id, asyncio.Lock())

    async def list_parameters(self, progress: Progress | None = None) -> ParameterSet:
        """See :func:`service.vehicle.listing.list_all`."""
        async with self._listing_lock:
            listed = await list_all(self, self.parameters, progress)
        self.listed = True
        return listed

    def demand(self, command_id: int, *params: float) -> None:
        """Send a command whose acknowledgement is not waited for; where the link is down it is lost."""
        with suppress(LinkDown):
            self._send_command(command_id, *params)

    def _send_command(self, command_id: int, *params: float) -> None:
        """Send a command whose acknowledgement does not matter, since its effect is seen."""
        full = [*map(float, params), *[0.0] * 7][:7]
        commands.check_allowed(command_id, full)
        self.send(dialect.MAVLink_command_long_message(self.system, self.component, command_id, 0, *full))

    async def identify(self) -> VehicleIdentity:
        """Ask who the vehicle is, the new way and the old one. Raises CommandTimeout if it does not say.

        A second answer is waited for: if it comes from another vehicle, that is in :attr:`conflicts` afterwards.
        """
        with self.waits.expect({VERSION_ID}, decode) as answer:
            for attempt in range(2 * _IDENTIFY_TRIES):
                if attempt % 2 == 0:
                    self._send_command(commands.REQUEST_MESSAGE, VERSION_ID)
                else:
                    self._send_command(commands.REQUEST_CAPABILITIES, 1)
                if await answer.within(1.0) is not None:
                    await answer.within(_SECOND_ANSWER_S)
                    return self.identity
        raise CommandTimeout(f"Vehicle {self.id} does not answer who it is (AUTOPILOT_VERSION).")

    # --- hearing ----------------------------------------------------------------------------------------------------

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """Hand this vehicle's frames of these messages to `callback`, until the returned function is called."""
        key = object()
        forget_ids = self.link.subscribe(lambda _batch: None, message_ids)
        self._subscribers[key] = (message_ids, callback, forget_ids)

        def unsubscribe() -> None:
            if self._subscribers.pop(key, None) is not None:
                forget_ids()

        return unsubscribe

    async def record(self, message_ids: frozenset[int], callback: FramesCallback) -> tuple[int, Callable[[], None]]:
        """Subscribe to exactly what the link's recording holds from a byte on; that byte, and how to stop.

        Raises
        ------
        LinkDown
            If the link is not connected.
        """
        begun: asyncio.Future[tuple[int, Callable[[], None]]] = asyncio.get_running_loop().create_future()

        def reached(position: int) -> None:
            if not begun.done():
                begun.set_result((position, self.subscribe(message_ids, callback)))

        hold = self.link.subscribe(lambda _batch: None, message_ids)
        try:
            self.link.mark(reached)
            await asyncio.wait({begun}, timeout=_MARK_S)
            if not begun.done():
                raise LinkDown(f"Link {self.link.id} ({self.link.endpoint}) does not read: {self.link.reason}")
        except BaseException:
            if begun.done():
                begun.result()[1]()
            begun.cancel()
            raise
        finally:
            hold()
        return begun.result()

    def feed(self, frames: Sequence[Frame], batch: Batch) -> None:
        """Take the frames of this vehicle out of a batch, in order."""
        now, since = batch.received_at, batch.since
        clock: float | None = None
        beating = False
        for frame in frames:
            message_id = frame.message_id
            clock = boot_time(frame) if message_id in BOOT_TIME_IDS else clock
            if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                beating = True
                self._ask_clock()
                self.heartbeat = decode(frame)
            if message_id in STATE_IDS:
                self._change(reduce(self.state, decode(frame), now, since))
            elif message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
                self.parameters.hear(frame, now)
            elif message_id == VERSION_ID:
                self._identified(decode(frame), now)
            self.waits.feed(frame)
        if clock is not None:
            self._clock_heard = True
            self._change(note_boot_time(self.state, clock))
        if self.state.last_heard != now:
            self.state = changed(self.state, last_heard=now)
        if beating:
            self._poll_when_due(now)
        self._hand_on(frames, batch)

    def _hand_on(self, frames: Sequence[Frame], batch: Batch) -> None:
        loop = asyncio.get_running_loop()
        for key, (message_ids, _, _) in list(self._subscribers.items()):
            chosen = [frame for frame in frames if frame.message_id in message_ids]
            if chosen:
                loop.call_soon(self._hand_frames, key, chosen, batch)

    def _hand_frames(self, key: object, frames: Sequence[Frame], batch: Batch) -> None:
        subscriber = self._subscribers.get(key)
        if subscriber is not None:
            subscriber[1](frames, batch)

    def _identified(self, message: Message, now: float) -> None:
        before = self.identity
        identity = identity_from_version(before, message)
        if before.uid2 is not None and identity.uid2 is not None and identity.uid2 != before.uid2:
            if self.clock() - self._stated_at >= self._yield_s:
                self.successor = identity.uid2
                return
            self._conflict(
                "uid2", f"Two vehicles answer to system id {self.system}: {before.uid2} and {identity.uid2}.", now
            )
            return
        self._stated_at = self.clock()
        self.identity = identity
        if identity != before:
            said = f"{identity.autopilot} {identity.version_text}, unique id {identity.uid2 or 'unknown'}"
            self._tell(VehicleEventKind.IDENTIFIED, said)

    def link_event(self, event: LinkEvent) -> None:
        """Take an event of the link into account if it concerns this vehicle."""
        ours = event.system == self.system and event.component == self.component
        if event.kind is LinkEventKind.OWN_IDS_HEARD or (ours and event.kind is LinkEventKind.DUPLICATE_SYSTEM):
            self._conflict(event.kind, event.text, self.clock())
        elif ours and event.kind is LinkEventKind.PEER_CHANGED:
            self._tell(VehicleEventKind.PEER_CHANGED, event.text)

    def _conflict(self, kind: str, text: str, now: float) -> None:
        told = kind in self._conflicts and now - self._conflicts[kind][1] < CONFLICT_S
        self._conflicts[kind] = (text, now)
        if not told:
            self._tell(VehicleEventKind.CONFLICT, text)

    # --- state ------------------------------------------------------------------------------------------------------

    @property
    def conflicts(self) -> tuple[str, ...]:
        """Doubts about who is being talked to, in sentences."""
        now = self.clock()
        doubts = [text for text, at in self._conflicts.values() if now - at < CONFLICT_S]
        return tuple([self._replaced, *doubts] if self._replaced else doubts)

    @property
    def heard_until(self) -> float:
        """The time until which it was listened to, s: now, or earlier where this program is late."""
        return min(self.clock(), self.link.heard_until)

    @property
    def silent(self) -> bool:
        """Whether its last heartbeat is more than 3 s older than what was read of the link."""
        return self.state.silent(self.heard_until)

    async def caught_up(self) -> None:
        """Return once everything that has arrived of it by now is in its state. Raises LinkDown."""
        await self.link.caught_up()

    def writable(self) -> Writable:
        """Whether a parameter may be written by what was heard so far, and why not; see :meth:`caught_up`."""
        found = writable(self.state, self.heard_until)
        doubts = self.conflicts
        if not doubts:
            return found
        refusals = (*found.refusals, *(Refusal.CONFLICT for _ in doubts))
        return Writable(ok=False, reasons=(*found.reasons, *doubts), refusals=refusals)

    def require_writable(self, *, name: str = "", sent: int = 0) -> None:
        """Raise VehicleSilent, VehicleArmed, VehicleConflict or VehicleBusy if it may not be written to."""
        found = self.writable()
        if not found.ok:
            _refuse(found, name, sent)

    def tick(self) -> None:
        """Let time pass: deadlines, silence, and asking again for a state that has grown old."""
        now = self.heard_until
        self.waits.tick(now)
        self._change(expire(self.state, now))
        silent = self.state.last_heartbeat is not None and self.state.silent(now)
        if silent != self._silent:
            self._silent = silent
            kind = VehicleEventKind.SILENT if silent else VehicleEventKind.HEARD_AGAIN
            self._tell(kind, "No heartbeat for 3 s." if silent else "Its heartbeat is back.")
        if not silent:
            self._poll_when_due(now)

    def _poll_when_due(self, now: float) -> None:
        """With time and with every heartbeat: a late event loop may have a turn only before what it is to hear."""
        if now - self._polled_at >= _POLL_S:
            self._polled_at = now
            self._poll(now)

    def _ask_clock(self) -> None:
        """With every heartbeat, where no stream tells the vehicle's time: a restart shows in it, and nowhere else."""
        if not self._clock_heard:
            self._ask_for([dialect.MAVLINK_MSG_ID_SYSTEM_TIME])
        self._clock_heard = False

    def _poll(self, now: float) -> None:
        """Ask for what makes the state where the vehicle does not send it by itself; changes no setting.

        Who it is is asked again and again: two vehicles behind one address with one system id both answer.
        """
        state, wanted = self.state, []
        if state.landed_at is None or now - state.landed_at >= _POLL_S:
            wanted.append(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        if state.throttle_at is None or now - state.throttle_at >= _POLL_S:
            wanted.append(dialect.MAVLINK_MSG_ID_VFR_HUD)
        if self.identity.known and now - self._asked_who_at >= _WHO_S:
            self._asked_who_at = now
            wanted.append(VERSION_ID)
        self._ask_for(wanted)

    def _ask_for(self, message_ids: Sequence[int]) -> None:
        """Ask for messages whose absence does no harm."""
        try:
            for message_id in message_ids:
                self._send_command(commands.REQUEST_MESSAGE, message_id)
        except LinkDown:
            return

    def give_way(self) -> str:
        """Another unit has taken this address: nothing is sent on behalf of this one any more. Says so."""
        self._replaced = (
            f"Another unit ({self.successor}) answers to system id {self.system} now; "
            f"{self.identity.uid2} was not heard for {self._yield_s:g} s."
        )
        self.close(VehicleConflict(self._replaced))
        return self._replaced

    def close(self, error: ServiceError) -> None:
        """End everything that waits for this vehicle, with an error."""
        self.waits.close(error)
        for _, _, forget_ids in self._subscribers.values():
            forget_ids()
        self._subscribers.clear()

    def _change(self, state: VehicleState) -> None:
        before, self.state = self.state, state
        if state is before:
            return
        if state.rebooted != before.rebooted:
            self.parameters.forget()
            self.listed = False
            self._tell(VehicleEventKind.REBOOTED, "The vehicle has restarted.")
        if state.armed != before.armed and state.armed is not None:
            kind = VehicleEventKind.ARMED if state.armed else VehicleEventKind.DISARMED
            self._tell(kind, f"The vehicle is {kind}.")
        if state.landed != before.landed:
            self._tell(VehicleEventKind.LANDED, f"The vehicle is {state.landed}.")
        if state.onboard_calibration is not None and before.onboard_calibration is None:
            self._tell(VehicleEventKind.CALIBRATING, f"It calibrates by itself: {state.onboard_calibration.text}.")
        if state.texts is not before.texts:
            for text in (text for text in state.texts if text not in before.texts):
                self._tell(VehicleEventKind.TEXT, text.text)

    def _tell(self, kind: VehicleEventKind, text: str) -> None:
        self._announce(self, kind, text)


def _refuse(found: Writable, name: str, sent: int) -> NoReturn:
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
