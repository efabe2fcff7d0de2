"""One link to one or more vehicles, as the event loop sees it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message, RawMessage, raw_message
from mavcal.calib.wire.signing import signing_time
from mavcal.service.errors import EndpointError, LinkDown
from mavcal.service.link.endpoint import Endpoint, EndpointKind, parse_endpoint
from mavcal.service.link.local import FileTransport, SerialTransport, SimTransport
from mavcal.service.link.loss import SequenceCounter
from mavcal.service.link.reader import Barrier, Mark, Outgoing, Reader, Report, StateChange
from mavcal.service.link.recorder import TlogRecorder
from mavcal.service.link.tcp import TcpServerTransport, TcpTransport
from mavcal.service.link.transports import Transport
from mavcal.service.link.types import (
    Address,
    Batch,
    BatchCallback,
    EventCallback,
    LinkEvent,
    LinkEventKind,
    LinkState,
    LinkStatistics,
    OwnIdentity,
    SigningConfig,
)
from mavcal.service.link.udp import UdpTransport

HEARTBEAT_S = 1.0
OFFERS, OFFER_S = 5, 1.0
"""Number of times that a vehicle is given its key, and the wait for a signed frame after each, s."""
_JOIN_S = 10.0
_LOOK_S = 10.0
"""Time without a read after which the reader counts as blocked, for example by the disk, s."""
_MERGED_S = 0.2
"""Longest time over which batches are joined, s; a batch counts as received with its last frame."""


def transport_of(endpoint: Endpoint) -> Transport:
    """The transport of an endpoint, not yet open. Raises EndpointError for an impossible option."""
    host_port = (endpoint.host, endpoint.port)
    match endpoint.kind:
        case EndpointKind.UDPIN:
            return UdpTransport(endpoint, host_port, None)
        case EndpointKind.UDPOUT:
            local_port = endpoint.number("local_port", 0)
            if local_port not in range(65536):
                raise EndpointError(f"local_port={local_port:g} in {endpoint} is no port")
            return UdpTransport(endpoint, ("", int(local_port)), host_port)
        case EndpointKind.TCP:
            return TcpTransport(endpoint)
        case EndpointKind.TCPIN:
            return TcpServerTransport(endpoint)
        case EndpointKind.SERIAL:
            return SerialTransport(endpoint)
        case EndpointKind.FILE:
            return FileTransport(endpoint)
        case EndpointKind.SIM:
            return SimTransport(endpoint)


class Link:
    """A link; everything here is called from the event loop.

    Parameters
    ----------
    link_id
        Names the link, and its recording.
    endpoint
        Where to; a string is parsed.
    tlog_dir
        Directory of the recording; each opening begins a new file there, and so does :meth:`rotate`.
    ids
        Our ids on the wire.
    signing
        None: frames are neither signed nor are signatures asked for.
    store_timestamp
        Called about once a second with the newest signature time stamp, which belongs into the next run's `signing`.
    """

    def __init__(
        self,
        link_id: str,
        endpoint: Endpoint | str,
        *,
        tlog_dir: Path,
        ids: OwnIdentity | None = None,
        signing: SigningConfig | None = None,
        store_timestamp: Callable[[int], None] | None = None,
    ) -> None:
        self.id = link_id
        self.endpoint = parse_endpoint(endpoint) if isinstance(endpoint, str) else endpoint
        self.ids = ids or OwnIdentity()
        self.hand = self.endpoint.hand
        """Who moves the simulated vehicle; None: it is no simulated one."""
        self.state = LinkState.CLOSED
        self.reason = "not opened yet"
        """Why the link is in its state."""
        self._tlog_dir = tlog_dir
        self._signing = signing
        self._store_timestamp = store_timestamp
        self._stored_timestamp = signing.timestamp if signing else 0
        self._confirmation: asyncio.Future[None] | None = None
        self._transport = transport_of(self.endpoint)
        self._recorder: TlogRecorder | None = None
        self._reader: Reader | None = None
        self._first_state: asyncio.Future[StateChange] | None = None
        self._heartbeat: asyncio.TimerHandle | None = None
        self._batch_subscribers: dict[object, tuple[BatchCallback, frozenset[int] | None]] = {}
        self._event_subscribers: dict[object, EventCallback] = {}
        self._unbroken = 0
        self._handing = 0
        self._handed_until = 0.0

    async def open(self) -> None:
        """Start reading and recording.

        Returns once the first attempt has ended. If nobody answers yet the link is ``down`` and goes on trying.

        Raises
        ------
        EndpointError, PortBusy
            If this endpoint can never work as it is.
        """
        loop = asyncio.get_running_loop()
        self._first_state = loop.create_future()
        self._recorder = self._new_recorder()
        self._reader = Reader(
            self.id,
            self._transport,
            self._recorder,
            own=self.ids,
            signing=self._signing,
            loop=loop,
            deliver=self._take_reports,
        )
        self._want()
        self._reader.start()
        change = await self._first_state
        if change.error is not None:
            await self.close()
            raise change.error
        if self._transport.answers:
            self._beat()

    async def close(self) -> None:
        """Stop everything that was started; the recording stays."""
        if self._heartbeat is not None:
            self._heartbeat.cancel()
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.stop()
            await asyncio.get_running_loop().run_in_executor(None, reader.join, _JOIN_S)
            self._take_reports(reader.take_reports())
            self._persist_timestamp(reader)
            reader.release()
            assert self._recorder is not None
            self._recorder.close()
        self._take_reports([StateChange(LinkState.CLOSED, "closed")])

    def subscribe(self, callback: BatchCallback, message_ids: frozenset[int] | None = None) -> Callable[[], None]:
        """Hand every batch to `callback`, until the function returned here is called.

        `message_ids` are needed at least (None: all); a batch also carries what others asked for.
        """
        key = object()
        self._batch_subscribers[key] = (callback, message_ids)
        self._want()

        def unsubscribe() -> None:
            self._batch_subscribers.pop(key, None)
            self._want()

        return unsubscribe

    def subscribe_events(self, callback: EventCallback) -> Callable[[], None]:
        """Hand every event to `callback`, until the function returned here is called."""
        key = object()
        self._event_subscribers[key] = callback
        return lambda: (self._event_subscribers.pop(key, None), None)[1]

    def send(self, message: Message | RawMessage, target: tuple[int, int] | None = None) -> None:
        """Send a message to the peer of a (system, component), or to everybody heard lately.

        Raises
        ------
        LinkDown
            If the link is not connected, or the target was never heard on it.
        InvalidInputError
            If the message cannot be encoded.
        """
        raw = raw_message(message)
        reader = self._connected()
        if not self._transport.answers:
            raise LinkDown(f"Link {self.id} replays a recording: nobody there can answer.")
        if target is not None and not (reader.peers.address(*target) or self._transport.default_peer()):
            raise LinkDown(f"Link {self.id}: nobody with system id {target[0]} was heard yet.")
        reader.send(Outgoing(raw, target))

    def _connected(self) -> Reader:
        """The reader. Raises LinkDown if the link is not connected."""
        if self._reader is None or self.state in (LinkState.DOWN, LinkState.CLOSED):
            raise LinkDown(f"Link {self.id} ({self.endpoint}) is {self.state}: {self.reason}")
        return self._reader

    @property
    def signing_key(self) -> str | None:
        """Name of the key in force; None: frames are not signed."""
        signing = self._reader.signing if self._reader else self._signing
        return None if signing is None else signing.name

    async def offer_key(self, signing: SigningConfig, target: tuple[int, int]) -> bool:
        """Give a vehicle a key, and sign once it signs with that key; False if it does not in time.

        Until then the link is unchanged: a vehicle that does not take the key is still heard.

        Raises
        ------
        LinkDown
            If the vehicle cannot be reached.
        """
        reader = self._reader
        if reader is None:
            raise LinkDown(f"Link {self.id} is not open.")
        self._confirmation = asyncio.get_running_loop().create_future()
        reader.offer(signing, target)
        try:
            for _ in range(OFFERS):
                now = signing_time(time.time())
                self.send(dialect.MAVLink_setup_signing_message(*target, signing.key, now), target)
                await asyncio.wait({self._confirmation}, timeout=OFFER_S)
                if self._confirmation.done():
                    break
        finally:
            reader.withdraw()
            self._confirmation = None
        if reader.signing is not signing:
            return False
        self._signing, self._stored_timestamp = signing, signing.timestamp
        return True

    def mark(self, reached: Callable[[int], None]) -> None:
        """Call `reached` between two batches, with the byte of the recording where the second begins.

        Whoever subscribed before this call gets the batches behind that place. Whoever subscribes in `reached` gets
        exactly what is recorded from there on. Frames that were recorded but not yet handed on lie before it.

        Raises
        ------
        LinkDown
            If the link is not connected.
        """
        if self._reader is None or self.state in (LinkState.DOWN, LinkState.CLOSED):
            raise LinkDown(f"Link {self.id} ({self.endpoint}) is {self.state}: {self.reason}")
        self._reader.mark(reached)

    async def caught_up(self) -> None:
        """Return once everything that had arrived before this call was handed to the subscribers.

        Raises
        ------
        LinkDown
            If the link is not connected, or its reader does not come to look.
        """
        reader = self._connected()
        done = asyncio.Event()
        reader.look(done.set)
        waiting = asyncio.ensure_future(done.wait())
        try:
            await asyncio.wait({waiting}, timeout=_LOOK_S)
        finally:
            waiting.cancel()
        if not done.is_set():
            raise LinkDown(f"Link {self.id} ({self.endpoint}) was not read for {_LOOK_S:g} s: {self.reason}")

    @property
    def heard_until(self) -> float:
        """What arrived before this time (monotonic clock, s) has been handed to the subscribers.

        A late event loop, or a reader that waits for its processor, makes it stand still: nothing that it does not
        cover is silence. Infinite while the link is down, since nothing can arrive then.
        """
        reader = self._reader
        if reader is None or self.state in (LinkState.DOWN, LinkState.CLOSED):
            return math.inf
        looked = reader.looked_at  # before `pending`: what was read by then is posted
        if not self._handing and not reader.pending:
            self._handed_until = max(self._handed_until, looked)
        return self._handed_until

    @property
    def tlog(self) -> TlogRecorder:
        """The recording: its ``path``, ``position`` (bytes written), ``error`` and ``await sync()``."""
        if self._recorder is None:
            raise LinkDown(f"Link {self.id} was not opened yet.")
        return self._recorder

    @contextmanager
    def unbroken(self) -> Iterator[None]:
        """Keep the recording in its present file inside the block."""
        self._unbroken += 1
        try:
            yield
        finally:
            self._unbroken -= 1

    def rotate(self) -> bool:
        """Go on recording in a new file; False: not now, because somebody needs it unbroken, or nothing is recorded.

        Raises
        ------
        StoreError
            If no file can be made; the recording then goes on in the old one.
        """
        if self._unbroken or self._reader is None or self.tlog.error is not None:
            return False
        self._recorder = self._new_recorder()
        self._reader.go_on_in(self._recorder)
        return True

    def _new_recorder(self) -> TlogRecorder:
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
        return TlogRecorder(self._tlog_dir / f"{self.id}-{stamp}.tlog")

    @property
    def peers(self) -> dict[tuple[int, int], Address]:
        """Which address each (system, component) was last heard from."""
        return self._reader.peers.snapshot() if self._reader else {}

    @property
    def crc_errors(self) -> int:
        """Frames with a wrong checksum on this link, from any sender."""
        return self._reader.crc_errors if self._reader else 0

    @property
    def sim_control(self) -> str | None:
        """``host:port`` of the control channel, if the link runs a simulated vehicle."""
        return self._transport.control if isinstance(self._transport, SimTransport) else None

    @property
    def local_port(self) -> int | None:
        """The port that a listening link has bound, or None."""
        if isinstance(self._transport, UdpTransport | TcpServerTransport) and self._reader is not None:
            return self._transport.local_port
        return None

    def statistics(self, system: int, component: int) -> LinkStatistics:
        """Statistics of one sender; all zero if nothing was received from it."""
        counter = self._reader.counters.get((system, component)) if self._reader else None
        return (counter or SequenceCounter()).statistics(self.crc_errors, time.monotonic())

    def _want(self) -> None:
        """Tell the reader the union of what subscribers need."""
        if self._reader is None:
            return
        asked = [ids for _, ids in self._batch_subscribers.values()]
        self._reader.wanted = None if None in asked else frozenset().union(*(ids for ids in asked if ids is not None))

    def _take_reports(self, reports: Iterable[Report]) -> None:
        loop = asyncio.get_running_loop()
        for batch in _merged(reports):
            if isinstance(batch, Batch):
                for key in list(self._batch_subscribers):
                    loop.call_soon(self._hand_batch, key, batch)
            elif isinstance(batch, StateChange):
                self._change_state(batch)
            elif isinstance(batch, Mark):
                loop.call_soon(batch.reached, batch.position)
            elif isinstance(batch, Barrier):
                loop.call_soon(batch.reached)
            else:
                self._announce(batch)
        self._handing += 1
        loop.call_soon(self._handed, 0.0 if self._reader is None else self._reader.taken_until)

    def _handed(self, until: float) -> None:
        """Note the end of a delivery."""
        self._handing -= 1
        self._handed_until = max(self._handed_until, until)

    def _hand_batch(self, key: object, batch: Batch) -> None:
        """Call one subscriber; each has its own callback in the loop, so that an exception in one spares the others."""
        subscriber = self._batch_subscribers.get(key)
        if subscriber is not None:
            subscriber[0](batch)

    def _hand_event(self, key: object, event: LinkEvent) -> None:
        callback = self._event_subscribers.get(key)
        if callback is not None:
            callback(event)

    def _announce(self, event: LinkEvent) -> None:
        confirmation = self._confirmation
        if event.kind is LinkEventKind.SIGNING_CONFIRMED and confirmation is not None and not confirmation.done():
            confirmation.set_result(None)
        loop = asyncio.get_running_loop()
        for key in list(self._event_subscribers):
            loop.call_soon(self._hand_event, key, event)

    def _change_state(self, change: StateChange) -> None:
        if self._first_state is not None and not self._first_state.done():
            self._first_state.set_result(change)
        if change.state == self.state and change.reason == self.reason:
            return
        self.state, self.reason = change.state, change.reason
        self._announce(LinkEvent(LinkEventKind.STATE, f"Link {self.id} is {change.state}: {change.reason}"))

    def _beat(self) -> None:
        """Send a heartbeat once a second from the event loop, so that a service that hangs falls silent."""
        if self._reader is None:
            return
        self._heartbeat = asyncio.get_running_loop().call_later(HEARTBEAT_S, self._beat)
        self._persist_timestamp(self._reader)
        if self.state in (LinkState.UP, LinkState.CONNECTING):
            self.send(
                dialect.MAVLink_heartbeat_message(
                    self.ids.type, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
                )
            )

    def _persist_timestamp(self, reader: Reader) -> None:
        state = reader.signature_state
        if state is not None and self._store_timestamp is not None and state.timestamp > self._stored_timestamp:
            self._stored_timestamp = state.timestamp
            self._store_timestamp(state.timestamp)


def _merged(reports: Iterable[Report]) -> list[Report]:
    """The reports with neighbouring batches joined, so that a backlog is passed on in few pieces."""
    merged: list[Report] = []
    run: list[Batch] = []

    def flush() -> None:
        if run:
            frames = tuple(frame for batch in run for frame in batch.frames)
            error = next((batch.tlog_error for batch in run if batch.tlog_error), None)
            first, last = run[0], run[-1]
            merged.append(Batch(frames, last.received_at, first.tlog_start, last.tlog_end, error, first.since))
            run.clear()

    for report in reports:
        if isinstance(report, Batch):
            late = run and report.received_at - run[0].received_at > _MERGED_S
            if late or (run and report.tlog_start < run[-1].tlog_end):  # the latter: another file has begun
                flush()
            run.append(report)
        else:
            flush()
            merged.append(report)
    flush()
    return merged
