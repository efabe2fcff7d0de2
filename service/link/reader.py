"""The thread of one link: all its input and output, its recording and its counters.

One thread does everything that touches the wire, so that nothing needs a lock and the recording has the order of the
wire. Towards the event loop go batches and events, with one wake-up for all that has gathered meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.calib.wire.signing import SignatureState, signing_time
from mavcal.service.errors import EndpointError, LinkDown, LinkError, PortBusy
from mavcal.service.link.loss import SequenceCounter
from mavcal.service.link.peers import PeerTable
from mavcal.service.link.recorder import TlogRecorder
from mavcal.service.link.transports import DRAIN, Chunk, Disconnected, Transport
from mavcal.service.link.types import Address, Batch, LinkEvent, LinkEventKind, LinkState, OwnIdentity, SigningConfig

_IDLE_S = 0.25
"""Longest wait for input; also the longest time for which a truncated frame holds back later ones."""
_PACE_S = 0.002
"""Pause between two drains of a fast link: fewer, larger batches cost less processor time."""
_BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 5.0)
_MAX_UNDELIVERED = 200_000
_WARN_EVERY_S = 5.0
_SETUP_SIGNING = 256
_MAX_SENDERS = 512
_FULL_BYTES = 4096
"""A chunk of so many bytes may be cut: more may be waiting behind it."""
_VITAL = frozenset({0})
"""HEARTBEAT, passed on even when the event loop is too late for anything else: it shows arming."""


class Outgoing(NamedTuple):
    """A message on its way; `target` None is for everybody."""

    message: RawMessage
    target: tuple[int, int] | None


class StateChange(NamedTuple):
    """The link's state, with the sentence that explains it, and the error if it is one for good."""

    state: LinkState
    reason: str
    error: LinkError | None = None


class Mark(NamedTuple):
    """A marker between two batches: the frames delivered after it are recorded from byte `position` on."""

    reached: Callable[[int], None]
    position: int


class _Offer(NamedTuple):
    signing: SigningConfig
    state: SignatureState
    target: tuple[int, int]


class Barrier(NamedTuple):
    """A marker between two batches: all input that had arrived when it was requested is delivered before it."""

    reached: Callable[[], None]


Report = Batch | LinkEvent | StateChange | Mark | Barrier


class Reader(threading.Thread):
    """Reads, records, counts, sends. Talks to the event loop through `deliver` only."""

    def __init__(
        self,
        name: str,
        transport: Transport,
        recorder: TlogRecorder,
        *,
        own: OwnIdentity,
        signing: SigningConfig | None,
        loop: asyncio.AbstractEventLoop,
        deliver: Callable[[list[Report]], None],
    ) -> None:
        super().__init__(name=f"link-{name}", daemon=True)
        self._transport = transport
        self._recorder = recorder
        self._next_recorder: TlogRecorder | None = None
        self._own = own
        self.signing = signing
        """The signing in force: frames are signed, and only signed ones are accepted. None: no signing."""
        self._offered: _Offer | None = None
        self._loop = loop
        self._deliver = deliver
        self.signature_state = SignatureState(signing.key, signing.timestamp) if signing else None
        self.wanted: frozenset[int] | None = frozenset()
        """Message ids handed to the event loop; None is all."""
        self.peers = PeerTable(own)
        self.counters: dict[tuple[int, int], SequenceCounter] = {}
        self._datagram_parser = FrameParser()
        self._stream_parsers: dict[Address, FrameParser] = {}
        self._closed_crc_errors = 0
        self._frames = 0
        self._outgoing: deque[Outgoing] = deque()
        self._marks: deque[Callable[[int], None]] = deque()
        self._asked: deque[Callable[[], None]] = deque()
        self.looked_at = 0.0
        """Time up to which all input has been read and posted, s of the monotonic clock."""
        self.taken_until = 0.0
        """The same time for the reports already taken."""
        self._sent: deque[bytes] = deque(maxlen=64)
        self._sequence = 0
        self._reports: deque[Report] = deque()
        self._scheduled = False
        self._posted_frames = self._delivered_frames = 0
        self._stopping = False
        self._state: LinkState | None = None
        self._recording_failed = False
        self._warned: dict[LinkEventKind, float] = {}
        self._wake_receive, self._wake_send = socket.socketpair()
        self._wake_receive.settimeout(0)
        self._wake_send.settimeout(0)

    # --- called from the event loop ---------------------------------------------------------------------------------

    def send(self, outgoing: Outgoing) -> None:
        """Queue a message."""
        self._outgoing.append(outgoing)
        self._wake()

    def mark(self, reached: Callable[[int], None]) -> None:
        """Ask for a :class:`Mark`; `wanted` as it is now holds for every frame behind it."""
        self._marks.append(reached)
        self._wake()

    def offer(self, signing: SigningConfig, target: tuple[int, int]) -> None:
        """Begin to use this key with the first frame that the target signs with it."""
        self._offered = _Offer(signing, SignatureState(signing.key, signing.timestamp), target)

    def withdraw(self) -> None:
        """Withdraw the key that was offered."""
        self._offered = None

    def go_on_in(self, recorder: TlogRecorder) -> None:
        """Record into another file from the next batch on, and close the one so far."""
        self._next_recorder = recorder
        self._wake()

    def look(self, reached: Callable[[], None]) -> None:
        """Request a :class:`Barrier` after everything that has arrived by now."""
        self._asked.append(reached)
        self._wake()

    def stop(self) -> None:
        """Ask the thread to end; join it afterwards, then :meth:`release`."""
        self._stopping = True
        self._wake()

    def release(self) -> None:
        """Close what the thread and the loop shared."""
        self._wake_receive.close()
        self._wake_send.close()

    def take_reports(self) -> list[Report]:
        """Everything posted so far."""
        self._scheduled = False
        self.taken_until = self.looked_at  # before anything is taken: what was read by then is posted
        reports = []
        while self._reports:
            report = self._reports.popleft()
            if isinstance(report, Batch):
                self._delivered_frames += len(report.frames)
            reports.append(report)
        return reports

    @property
    def pending(self) -> bool:
        """Whether something is posted that was not taken yet."""
        return bool(self._reports)

    @property
    def crc_errors(self) -> int:
        """Places on this link that looked like a frame and had a wrong checksum."""
        open_streams = sum(parser.crc_errors for parser in list(self._stream_parsers.values()))
        return self._datagram_parser.crc_errors + open_streams + self._closed_crc_errors

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # full: it is awake anyway; closed: it has ended
            self._wake_send.send(b"x")

    # --- the thread -------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Connect, serve, and connect again until told to stop."""
        attempt = 0
        ended = False
        try:
            while not (self._stopping or ended):
                with selectors.DefaultSelector() as selector:
                    selector.register(self._wake_receive, selectors.EVENT_READ)
                    served, ended = self._connection(selector)
                    attempt = 0 if served else attempt + 1
                    if not ended:
                        self._rest(selector, _BACKOFF_S[min(attempt, len(_BACKOFF_S) - 1)])
            ended = True
        finally:
            self._renew_recorder()
            self._transport.close()
            if not ended:
                self._set_state(LinkState.DOWN, "the reader of this link failed; the log of the service says why")

    def _connection(self, selector: selectors.BaseSelector) -> tuple[bool, bool]:
        """One connection from opening to its end. Returns whether it was ever open, and whether it is the last."""
        first = self._state is None
        try:
            self._transport.open(selector)
        except (EndpointError, PortBusy) as exc:
            self._set_state(LinkState.DOWN, str(exc), exc)
            return False, first
        except LinkDown as exc:
            self._set_state(LinkState.DOWN, str(exc))
            return False, False
        if self._transport.connected_when_open:
            self._set_state(LinkState.UP, "connected")
        else:
            self._set_state(LinkState.CONNECTING, "waiting for a vehicle to speak")
        self.looked_at = time.monotonic()  # nothing of this connection arrived before it was open
        try:
            self._serve(selector)
        except Disconnected as exc:
            self._set_state(LinkState.DOWN, str(exc))
        finally:
            self._transport.close()
            self._drop_streams()
        return True, self._transport.ends

    def _serve(self, selector: selectors.BaseSelector) -> None:
        last_drain = last_data = 0.0
        while not self._stopping:
            wait = self._transport.wait()
            selector.select(_IDLE_S if wait is None else min(wait, _IDLE_S))
            self._empty_wake()
            self._renew_recorder()  # before any mark: whoever asked for a place since then finds it in the new file
            self._post_marks()
            self._send_queued()
            if self._congested() and self._transport.lossless:
                time.sleep(_PACE_S)
                continue
            asked, began = len(self._asked), time.monotonic()
            chunks = self._transport.receive()
            now = time.monotonic()
            if chunks:
                self._take(chunks, now)
            if not _cut(chunks):
                self._post_looked(asked)
                self.looked_at = began
            if chunks:
                if now - last_drain < _PACE_S / 2 and len(chunks) < 64:
                    time.sleep(_PACE_S)
                last_drain = last_data = now
            elif now - last_data >= _IDLE_S:
                self._finish_streams(now)

    def _rest(self, selector: selectors.BaseSelector, seconds: float) -> None:
        """Wait before the next attempt; what was to be sent meanwhile is dropped."""
        until = time.monotonic() + seconds
        while not self._stopping and (left := until - time.monotonic()) > 0:
            selector.select(left)
            self._empty_wake()
            self._outgoing.clear()

    def _empty_wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wake_receive.recv(4096)

    def _renew_recorder(self) -> None:
        fresh, self._next_recorder = self._next_recorder, None
        if fresh is not None:
            fresh.follow(self._recorder)
            self._recorder.close()
            self._recorder = fresh

    def _post_marks(self) -> None:
        while self._marks:
            self._post(Mark(self._marks.popleft(), self._recorder.position))

    def _post_looked(self, count: int) -> None:
        """Answer those who had asked before the last input was read."""
        for _ in range(count):
            self._post(Barrier(self._asked.popleft()))

    # --- receiving --------------------------------------------------------------------------------------------------

    def _take(self, chunks: list[Chunk], now: float) -> None:
        frames: list[tuple[Frame, Chunk]] = []
        for chunk in chunks:
            for frame in self._parse(chunk):
                frames.append((frame, chunk))
        if frames:
            self._accept(frames, now)

    def _parse(self, chunk: Chunk) -> list[Frame]:
        if self._transport.datagrams:
            return self._datagram_parser.feed_datagram(chunk.data)
        parser = self._stream_parsers.get(chunk.peer)
        if parser is None:
            parser = self._stream_parsers.setdefault(chunk.peer, FrameParser())
        return parser.feed(chunk.data)

    def _finish_streams(self, now: float) -> None:
        """Flush the parsers of idle streams, so that a truncated frame no longer holds back later ones."""
        for peer, parser in self._stream_parsers.items():
            if parser.pending:
                frames = parser.finish()
                if frames:
                    self._accept([(frame, Chunk(b"", peer)) for frame in frames], now)

    def _drop_streams(self) -> None:
        self._closed_crc_errors += sum(parser.crc_errors for parser in self._stream_parsers.values())
        self._stream_parsers.clear()

    def _accept(self, frames: list[tuple[Frame, Chunk]], now: float) -> None:
        """Authenticate, count, route, record and filter a frame, in a few microseconds."""
        wanted, stamp = self.wanted, self._recorder.stamp()
        kept: list[Frame] = []
        records: list[bytes] = []
        key: tuple[int, ...] = ()
        peer: Address | None = None
        counter: SequenceCounter | None = None
        for frame, chunk in frames:
            if self._suspicious(frame) and self._refused(frame, chunk, now):
                continue
            if frame[2:4] != key or chunk.peer != peer:
                key, peer = frame[2:4], chunk.peer
                counter = self._sender(frame.system, frame.component, peer, now)
            self._frames += 1
            if counter is not None:
                share = 1.0 if not chunk.dropped else (counter.received + 1) / self._frames
                counter.see(frame.sequence, now, len(frame.raw), chunk.dropped, share)
            records += (stamp, frame.raw)
            if wanted is None or frame.message_id in wanted:
                kept.append(frame)
        if records:
            self._record_and_post(kept, records, now)

    def _record_and_post(self, kept: list[Frame], records: list[bytes], now: float) -> None:
        if self._state is LinkState.CONNECTING:
            self._set_state(LinkState.UP, "a vehicle speaks")
        start = self._recorder.position
        self._write(records)
        if self._congested() and not self._transport.lossless:
            self._warn(LinkEventKind.OVERRUN, "frames are recorded but not delivered: this machine is too slow", now)
            kept = [frame for frame in kept if frame.message_id in _VITAL]
        self._posted_frames += len(kept)
        if kept or self._recorder.error:
            batch = Batch(tuple(kept), now, start, self._recorder.position, self._recorder.error, self.looked_at)
            self._post(batch)

    def _suspicious(self, frame: Frame) -> bool:
        return (
            self.signature_state is not None
            or self._offered is not None
            or (frame.system == self._own.system and frame.component == self._own.component)
        )

    def _refused(self, frame: Frame, chunk: Chunk, now: float) -> bool:
        """True for frames that must not be accepted: wrongly signed, or with our own ids."""
        offered = self._offered
        if offered is not None and frame[2:4] == offered.target and self._confirmed(frame, offered):
            return False
        if self.signature_state is not None and self.signing is not None:
            exempt = frame.signature is None and frame.message_id in self.signing.accept_unsigned
            if not exempt and not self.signature_state.accept(frame):
                who = f"{frame.system}/{frame.component}"
                self._warn(
                    LinkEventKind.SIGNATURE_REFUSED,
                    f"A frame of {who} was refused: not signed with this link's key, or its time stamp is old.",
                    now,
                )
                return True
        if frame.system != self._own.system or frame.component != self._own.component or not self._transport.answers:
            return False
        if frame.raw not in self._sent:  # an echo of our own is nobody else
            event = self.peers.own_ids(chunk.peer, now)
            if event is not None:
                self._post(event)
        return True

    def _confirmed(self, frame: Frame, offered: _Offer) -> bool:
        """Whether a frame proves that its sender has taken the key that was offered; then it is in force."""
        if frame.signature is None or not offered.state.accept(frame):
            return False
        self._offered, self.signing, self.signature_state = None, offered.signing, offered.state
        who = f"{frame.system}/{frame.component}"
        text = f"{who} signs with the key {offered.signing.name!r}: this link is signed from now on."
        self._post(LinkEvent(LinkEventKind.SIGNING_CONFIRMED, text, frame.system, frame.component))
        return True

    def _sender(self, system: int, component: int, peer: Address, now: float) -> SequenceCounter | None:
        """Counter of a sender, whose address is noted; None if there are too many senders."""
        event = self.peers.see(system, component, peer, now)
        if event is not None:
            self._post(event)
        counter = self.counters.get((system, component))
        if counter is None and len(self.counters) < _MAX_SENDERS:
            counter = self.counters.setdefault((system, component), SequenceCounter())
        return counter

    # --- sending ----------------------------------------------------------------------------------------------------

    def _send_queued(self) -> None:
        records = []
        while self._outgoing:
            message, target = self._outgoing.popleft()
            peers = self._route(target)
            if not peers:
                continue
            frame = self._encode(message)
            self._sent.append(frame)
            for peer in peers:
                self._transport.send(frame, peer)
            if message.message_id != _SETUP_SIGNING:  # it carries the key itself
                records += [self._recorder.stamp(), frame]
        if records:
            self._write(records)

    def _route(self, target: tuple[int, int] | None) -> tuple[Address, ...]:
        default = self._transport.default_peer()
        if target is not None:
            address = self.peers.address(*target) or default
            return (address,) if address else ()
        recent = self.peers.recent(time.monotonic())
        return recent if default is None or default in recent else (*recent, default)

    def _encode(self, message: RawMessage) -> bytes:
        signing = None
        if self.signature_state is not None and self.signing is not None:
            signing = self.signature_state.next_signing(self.signing.link_id, signing_time(time.time()))
        self._sequence = (self._sequence + 1) & 0xFF
        return encode(message, self._own.system, self._own.component, self._sequence, signing)

    # --- recording and reporting ------------------------------------------------------------------------------------

    def _write(self, records: list[bytes]) -> None:
        self._recorder.write(records)
        failed = self._recorder.error is not None
        if failed != self._recording_failed:
            self._recording_failed = failed
            self._post(LinkEvent(LinkEventKind.TLOG, str(self._recorder.error) if failed else "Recording goes on."))

    def _congested(self) -> bool:
        return self._posted_frames - self._delivered_frames > _MAX_UNDELIVERED

    def _warn(self, kind: LinkEventKind, text: str, now: float) -> None:
        if now - self._warned.get(kind, -1e9) >= _WARN_EVERY_S:
            self._warned[kind] = now
            self._post(LinkEvent(kind, text))

    def _set_state(self, state: LinkState, reason: str, error: LinkError | None = None) -> None:
        self._state = state
        self._post(StateChange(state, reason, error))

    def _post(self, report: Report) -> None:
        self._reports.append(report)
        if not self._scheduled:
            self._scheduled = True
            with contextlib.suppress(RuntimeError):  # the loop has ended: nobody is left to tell
                self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        self._deliver(self.take_reports())


def _cut(chunks: list[Chunk]) -> bool:
    """Whether the last read was cut off by its limit, so that more input may wait."""
    return len(chunks) >= DRAIN or any(len(chunk.data) >= _FULL_BYTES for chunk in chunks)
