"""One vehicle: its identity, its state, and everything that is sent to it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message, RawMessage, decode
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CommandTimeout, LinkDown, ServiceError, VehicleBusy, VehicleConflict
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkEvent, LinkEventKind, OwnIdentity
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.boot_time import BOOT_TIME_IDS, boot_time
from mavcal.service.vehicle.channels import Channels, LinkChannel
from mavcal.service.vehicle.events import VehicleEventKind
from mavcal.service.vehicle.exchange import Pace, Waits
from mavcal.service.vehicle.heard import STATE_IDS, VERSION_ID
from mavcal.service.vehicle.identity import VehicleIdentity, identity_from_heartbeat, identity_from_version
from mavcal.service.vehicle.listing import ParameterSet, Progress, list_all
from mavcal.service.vehicle.parameters import Parameters
from mavcal.service.vehicle.rate_ledger import RateLedger
from mavcal.service.vehicle.state import (
    Refusal,
    VehicleState,
    Writable,
    changed,
    expire,
    reduce,
    refuse,
    restarted,
    writable,
)
from mavcal.service.vehicle.subscribers import FramesCallback, Subscribers, begun_at

CONFLICT_S = 30.0
"""Time for which a doubt about the addressee holds after its last sign, s."""
YIELD_S = 30.0
"""Time after which a silent unit is replaced by another one with its system id, s. Identity is requested every 5 s:
while both units are there, both answer, and the conflict stays."""
_POLL_S = 2.0
_WHO_S = 5.0
_SECOND_ANSWER_S = 0.3
_IDENTIFY_TRIES = 5
Announce = Callable[["Vehicle", VehicleEventKind, str], None]
"""Called with the vehicle, the kind of event, and a sentence on it."""


class Vehicle:
    """A unit, addressed by (system, component) over one or more links. Everything is called from the event loop.

    It is spoken to over the link in use; see :mod:`service.vehicle.channels` for what counts from which link.
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
        self.channels = Channels(link, clock)
        self.system = system
        self.component = component
        self.clock = clock
        self.id = f"{link.id}-{system}-{component}"
        """Stable and URL-safe; the registry makes it from the unique id once that is known."""
        self.identity: VehicleIdentity = identity_from_heartbeat(heartbeat)
        self.state = VehicleState()
        self.waits = Waits(clock)
        self.pace = Pace()
        """Pace of its answers."""
        self.parameters = Parameters(self)
        self.listed = False
        """Whether the whole list was read since the vehicle's start; some parameters are heard unrequested."""
        self.carried: tuple[float, float] | None = None
        """Capacity of the link measured under overload, bytes/s, and when; None: never measured."""
        self._announce = announce
        self._listing_lock = asyncio.Lock()
        self._command_locks: dict[int, asyncio.Lock] = {}
        self._subscribers = Subscribers()
        self._conflicts: dict[str, tuple[str, float]] = {}
        self._silent = False
        self._polled_at = self._asked_who_at = -1e9
        self._yield_s = yield_s
        self.found_at = clock()
        self.settled = False
        """Whether it is decided which unit this is; until then it may be one known on another link."""
        self.undecided = ""
        """Sentence on the open decision, during which nothing is written; empty: there is none."""
        self.joined: Vehicle | None = None
        """The vehicle on another link that this one turned out to be."""
        self.gone = False
        """Whether it was closed."""
        self.rates = RateLedger()
        self._replaced = ""
        self.heartbeat = heartbeat
        """The last unique id heard at this address, even of another unit."""
        self.successor: str | None = None
        """Unique id of another unit that answers here after this one has been silent for long enough."""

    # --- talking ----------------------------------------------------------------------------------------------------

    @property
    def link(self) -> Link:
        """The link in use."""
        return self.channels.in_use.link

    @property
    def links(self) -> tuple[Link, ...]:
        """Every link over which it was heard, the one in use first."""
        others = [channel.link for channel in self.channels if channel is not self.channels.in_use]
        return (self.link, *others)

    @property
    def way(self) -> str:
        """Name of the link in use."""
        return self.link.id

    @property
    def unit(self) -> Vehicle:
        """The vehicle itself, or the one that it turned out to be."""
        return self if self.joined is None else self.joined.unit

    @property
    def own(self) -> OwnIdentity:
        """Our own MAVLink ids in messages to it."""
        return self.link.ids

    def send(self, message: Message | RawMessage) -> None:
        """Send to this vehicle over the link in use, or where that is down over another one. Raises LinkDown."""
        target = (self.system, self.component)
        try:
            self.link.send(message, target)
        except LinkDown as down:
            if not self._fail_over(str(down)):
                raise
            self.link.send(message, target)

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
            self.send_command(command_id, *params)

    def send_command(self, command_id: int, *params: float) -> None:
        """Send a command whose acknowledgement does not matter, since its effect is seen. Raises LinkDown."""
        self.send(self._command_message(command_id, *params))

    def _command_message(self, command_id: int, *params: float) -> Message:
        full = [*map(float, params), *[0.0] * 7][:7]
        commands.check_allowed(command_id, full)
        return dialect.MAVLink_command_long_message(self.system, self.component, command_id, 0, *full)

    async def identify(self) -> VehicleIdentity:
        """Ask who the vehicle is, the new way and the old one. Raises CommandTimeout if it does not say.

        A second answer is waited for: if it comes from another vehicle, that is in :attr:`conflicts` afterwards.
        """
        with self.waits.expect({VERSION_ID}, decode) as answer:
            for attempt in range(2 * _IDENTIFY_TRIES):
                if attempt % 2 == 0:
                    self.send_command(commands.REQUEST_MESSAGE, VERSION_ID)
                else:
                    self.send_command(commands.REQUEST_CAPABILITIES, 1)
                if await answer.within(1.0) is not None:
                    await answer.within(_SECOND_ANSWER_S)
                    return self.identity
        raise CommandTimeout(f"Vehicle {self.id} does not answer who it is (AUTOPILOT_VERSION).")

    # --- hearing ----------------------------------------------------------------------------------------------------

    def subscribe(
        self, message_ids: frozenset[int], callback: FramesCallback, *, over: Link | None = None
    ) -> Callable[[], None]:
        """Pass this vehicle's frames of these messages to `callback` until the returned function is called.

        They are those of the link in use, or of the link `over`.
        """
        return self._subscribers.add(message_ids, callback, self.links, over)

    async def record(self, message_ids: frozenset[int], callback: FramesCallback) -> tuple[int, Callable[[], None]]:
        """Subscribe to exactly what the recording of the link in use holds from a byte on; that byte, and how to stop.

        The frames stay those of that link, also when another one comes into use.

        Raises
        ------
        LinkDown
            If the link is not connected.
        """
        link = self.link
        return await begun_at(link, message_ids, lambda: self.subscribe(message_ids, callback, over=link))

    def feed(self, frames: Sequence[Frame], batch: Batch, link: Link | None = None) -> None:
        """Take the frames of this vehicle out of a batch of a link (None: the one in use), in order."""
        channel = self.channels.in_use if link is None else self.channels.of(link)
        now, since = batch.received_at, batch.since
        channel.hear(now, self.state.rebooted)
        beating, stamp = False, None
        for frame in frames:
            stamp = boot_time(frame) if frame.message_id in BOOT_TIME_IDS else stamp
            beating |= frame.message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT
            self._take(frame, channel, now, since)
        if stamp is not None:
            self._hear_clock(stamp, channel, now)
        if self.state.last_heard != now:
            self.state = changed(self.state, last_heard=now)
        if self.channels.overdue():
            self._fail_over(f"no heartbeat over link {self.way} for 3 s")
        if beating:
            self._poll_when_due(now)
        self._subscribers.hand_on(frames, batch, channel.link, used=channel is self.channels.in_use)

    def _take(self, frame: Frame, channel: LinkChannel, now: float, since: float | None) -> None:
        message_id = frame.message_id
        used = channel is self.channels.in_use
        if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            channel.last_heartbeat = now
            self.heartbeat = decode(frame)
            self._ask_clock(channel)
            self._change(reduce(self.state, self.heartbeat, now, since))
        elif used and message_id in STATE_IDS:
            self._change(reduce(self.state, decode(frame), now, since))
        elif used and message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            self.parameters.hear(frame)
        elif message_id == VERSION_ID:
            self._identified(decode(frame), channel, now)
        self.waits.feed(frame, beside=not used)

    def _hear_clock(self, stamp: float, channel: LinkChannel, now: float) -> None:
        """Take in a time stamp; a restart that any link shows counts once."""
        channel.clock.see(stamp, now)
        channel.clock_heard = True
        if channel.clock.restarts > self.state.rebooted:
            self._change(restarted(self.state, stamp))
            self.channels.restarted(self.state.rebooted)
        elif channel is self.channels.in_use and channel.clock.latest != self.state.boot_time:
            self.state = changed(self.state, boot_time=channel.clock.latest)

    def _identified(self, message: Message, channel: LinkChannel, now: float) -> None:
        before = self.identity
        identity = identity_from_version(before, message)
        if before.uid2 is not None and identity.uid2 is not None and identity.uid2 != before.uid2:
            self._contradicted(identity.uid2, channel, now)
            return
        channel.stated_at = self.clock()
        if channel is not self.channels.in_use:
            return
        self.identity = identity
        if identity != before:
            text = f"{identity.autopilot} {identity.version_text}, unique id {identity.uid2 or 'unknown'}"
            self._emit(VehicleEventKind.IDENTIFIED, text)

    def _contradicted(self, uid2: str, channel: LinkChannel, now: float) -> None:
        """Handle an answer of another unit at our address on this link."""
        gone = self.clock() - channel.stated_at >= self._yield_s
        if channel is not self.channels.in_use or (gone and len(self.channels) > 1):
            channel.stranger = uid2
        elif gone:
            self.successor = uid2
        else:
            text = f"Two vehicles answer to system id {self.system}: {self.identity.uid2} and {uid2}."
            self._conflict("uid2", text, now)

    # --- links

    def join(self, other: Vehicle) -> None:
        """Take over the links of `other`, which turned out to be this unit, and close `other`."""
        for channel in other.channels:
            channel.clock.restarts = self.state.rebooted
            self.channels.join(channel)
            self._subscribers.join(channel.link)
        other.joined = self
        other.close(VehicleBusy(f"This is the vehicle {self.id}, heard over one more link: ask again."))
        self._emit(VehicleEventKind.LINKS, f"It is heard over {', '.join(link.id for link in self.links)}.")

    def decide_again(self) -> None:
        """Decide again which unit this is."""
        self.settled, self.found_at = False, self.clock()

    def leave(self, link: Link, why: str) -> None:
        """Remove a link, which must not be the only one."""
        used = link is self.link
        self.channels.leave(link)
        self._subscribers.leave(link)
        self.rates.forget_link(link.id)
        if used:
            self._moved(why)
        self._emit(VehicleEventKind.LINKS, f"It is not heard over {link.id} any more: {why}.")

    def _fail_over(self, why: str) -> bool:
        """Use another link over which the vehicle is heard; False: there is none."""
        if not self.channels.fail_over():
            return False
        self._moved(why)
        return True

    def _moved(self, why: str) -> None:
        """Discard what was learnt of the old link, because another one is in use."""
        self.pace, self.carried = Pace(), None
        self._emit(VehicleEventKind.MOVED, f"It is spoken to over {self.way} now: {why}.")

    def link_event(self, event: LinkEvent) -> None:
        """Take an event of the link into account if it concerns this vehicle."""
        ours = event.system == self.system and event.component == self.component
        if event.kind is LinkEventKind.OWN_IDS_HEARD or (ours and event.kind is LinkEventKind.DUPLICATE_SYSTEM):
            self._conflict(event.kind, event.text, self.clock())
        elif ours and event.kind is LinkEventKind.PEER_CHANGED:
            self._emit(VehicleEventKind.PEER_CHANGED, event.text)

    def _conflict(self, kind: str, text: str, now: float) -> None:
        announced = kind in self._conflicts and now - self._conflicts[kind][1] < CONFLICT_S
        self._conflicts[kind] = (text, now)
        if not announced:
            self._emit(VehicleEventKind.CONFLICT, text)

    # --- state ------------------------------------------------------------------------------------------------------

    @property
    def conflicts(self) -> tuple[str, ...]:
        """Reasons to doubt which unit answers, in sentences."""
        return tuple(text for text in (self._replaced, *self._doubts(), self.undecided) if text)

    @property
    def conflicts_of_address(self) -> bool:
        """Whether it is doubtful who answers at its address."""
        return bool(self._doubts())

    def _doubts(self) -> list[str]:
        now = self.clock()
        return [text for text, at in self._conflicts.values() if now - at < CONFLICT_S]

    @property
    def heard_until(self) -> float:
        """The time until which its links have been read, s: now, or earlier if this program is late."""
        return self.channels.heard_until

    @property
    def silent(self) -> bool:
        """Whether its last heartbeat is more than 3 s older than what was read of the link."""
        return self.state.silent(self.heard_until)

    async def caught_up(self) -> None:
        """Return once everything received from it by now is in its state. Raises LinkDown."""
        await self.channels.caught_up()

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
            refuse(found, name, sent)

    def tick(self) -> None:
        """Check deadlines and silence at this instant, and ask again for a state that is too old."""
        if self.channels.overdue():
            self._fail_over(f"no heartbeat over link {self.way} for 3 s")
        elif not (self._subscribers or self.waits.any or self.rates.requested_us) and self.channels.prefer():
            self._moved("it carries more")
        now = self.heard_until
        self.waits.tick(now)
        self._change(expire(self.state, now))
        silent = self.state.last_heartbeat is not None and self.state.silent(now)
        if silent != self._silent:
            self._silent = silent
            kind = VehicleEventKind.SILENT if silent else VehicleEventKind.HEARD_AGAIN
            self._emit(kind, "No heartbeat for 3 s." if silent else "Its heartbeat is back.")
        if not silent:
            self._poll_when_due(now)

    def _poll_when_due(self, now: float) -> None:
        """Poll every 2 s; called by the clock and at every heartbeat, so that a late event loop polls too."""
        if now - self._polled_at >= _POLL_S:
            self._polled_at = now
            self._poll(now)

    def _ask_clock(self, channel: LinkChannel) -> None:
        """Ask for the vehicle's time, which shows a restart, unless it has come since the last heartbeat."""
        if not channel.clock_heard:
            self._ask_over(channel, dialect.MAVLINK_MSG_ID_SYSTEM_TIME)
        channel.clock_heard = False

    def _poll(self, now: float) -> None:
        """Request the messages that make the state if the vehicle does not stream them; no setting changes.

        Its identity is requested repeatedly: two vehicles behind one address with one system id both answer.
        """
        state, wanted = self.state, []
        if state.landed_at is None or now - state.landed_at >= _POLL_S:
            wanted.append(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        if state.throttle_at is None or now - state.throttle_at >= _POLL_S:
            wanted.append(dialect.MAVLINK_MSG_ID_VFR_HUD)
        for message_id in wanted:
            self._ask_over(self.channels.in_use, message_id)
        if self.identity.known and now - self._asked_who_at >= _WHO_S:
            self._asked_who_at = now
            for channel in self.channels:
                self._ask_over(channel, VERSION_ID)

    def _ask_over(self, channel: LinkChannel, message_id: int) -> None:
        """Ask over this very link for a message whose absence does no harm."""
        self.demand_over(channel.link, commands.REQUEST_MESSAGE, message_id)

    def demand_over(self, link: Link, command_id: int, *params: float) -> None:
        """See :meth:`demand`, over this very link."""
        with suppress(LinkDown):
            link.send(self._command_message(command_id, *params), (self.system, self.component))

    def mark_replaced(self) -> str:
        """Stop sending to this unit, because another one has taken its address. Returns why."""
        self._replaced = (
            f"Another unit ({self.successor}) answers to system id {self.system} now; "
            f"{self.identity.uid2} was not heard for {self._yield_s:g} s."
        )
        self.close(VehicleConflict(self._replaced))
        return self._replaced

    def close(self, error: ServiceError) -> None:
        """End everything that waits for this vehicle, with an error."""
        self.gone = True
        self.waits.close(error)
        self._subscribers.close()

    def _change(self, state: VehicleState) -> None:
        before, self.state = self.state, state
        if state is before:
            return
        if state.rebooted != before.rebooted:
            self.parameters.forget()
            self.listed = False
            self._emit(VehicleEventKind.REBOOTED, "The vehicle has restarted.")
        if state.armed != before.armed and state.armed is not None:
            kind = VehicleEventKind.ARMED if state.armed else VehicleEventKind.DISARMED
            self._emit(kind, f"The vehicle is {kind}.")
        if state.landed != before.landed:
            self._emit(VehicleEventKind.LANDED, f"The vehicle is {state.landed}.")
        if state.onboard_calibration is not None and before.onboard_calibration is None:
            self._emit(VehicleEventKind.CALIBRATING, f"It calibrates by itself: {state.onboard_calibration.text}.")
        if state.texts is not before.texts:
            for text in (text for text in state.texts if text not in before.texts):
                self._emit(VehicleEventKind.TEXT, text.text)

    def _emit(self, kind: VehicleEventKind, text: str) -> None:
        self._announce(self, kind, text)
