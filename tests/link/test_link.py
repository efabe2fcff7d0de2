from __future__ import annotations

import asyncio
import os
import socket
import threading
import time
import tty
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import decode, encode
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.calib.wire.signing import Signing, check_signature
from mavcal.calib.wire.tlog import TlogReader, iter_tlog, tlog_record
from mavcal.service.errors import EndpointError, LinkDown, PortBusy
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkEvent, LinkEventKind, LinkState, OwnIdentity, SigningConfig
from tests.patience import scaled

KEY = bytes(range(32))


def heartbeat() -> Any:
    return dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)


def imu(x: int = 0) -> Any:
    return dialect.MAVLink_raw_imu_message(10**6, x, 2, -1000, 4, 5, 6, 7, 8, 9, 0, 3500)


class Collector:
    """Takes what a link hands out, and waits for it to be enough."""

    def __init__(self, link: Link, message_ids: frozenset[int] | None = None) -> None:
        self.batches: list[Batch] = []
        self.events: list[LinkEvent] = []
        self._changed = asyncio.Event()
        link.subscribe(self._batch, message_ids)
        link.subscribe_events(self._event)

    def _batch(self, batch: Batch) -> None:
        self.batches.append(batch)
        self._changed.set()

    def _event(self, event: LinkEvent) -> None:
        self.events.append(event)
        self._changed.set()

    @property
    def frames(self) -> list[Frame]:
        return [frame for batch in self.batches for frame in batch.frames]

    async def until(self, condition: Callable[[], bool], seconds: float = 8.0) -> None:
        async with asyncio.timeout(scaled(seconds)):
            while not condition():
                self._changed.clear()
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), 0.1)


Opener = Callable[..., Awaitable[Link]]


@pytest.fixture
async def opened(tmp_path: Path) -> AsyncIterator[Opener]:
    links: list[Link] = []

    async def make(endpoint: str, **kw: Any) -> Link:
        link = Link(f"link{len(links)}", endpoint, tlog_dir=tmp_path, **kw)
        await link.open()
        links.append(link)
        return link

    yield make
    for link in links:
        await link.close()


@pytest.fixture
def peer() -> Any:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(scaled(5))
        yield opened


def second_socket() -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    return opened


async def received(peer: socket.socket, message_id: int) -> tuple[Frame, tuple[str, int]]:
    def take() -> tuple[Frame, tuple[str, int]]:
        while True:
            data, address = peer.recvfrom(4096)
            for frame in FrameParser().feed(data):
                if frame.message_id == message_id:
                    return frame, address

    return await asyncio.to_thread(take)


async def everything(peer: socket.socket) -> set[int]:
    """Ids of all messages that come, and of what else comes within a moment after the first, but for heartbeats."""

    def take() -> set[int]:
        peer.settimeout(scaled(5))
        ids: set[int] = set()
        with suppress(TimeoutError):
            while True:
                ids |= {frame.message_id for frame in FrameParser().feed(peer.recv(4096))} - {0}
                peer.settimeout(0.3 if ids else scaled(5))
        return ids

    return await asyncio.to_thread(take)


async def test_a_heartbeat_comes_in_and_ours_goes_back_to_who_spoke(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    assert link.state is LinkState.CONNECTING
    peer.sendto(encode(heartbeat(), 1, 1, 0), ("127.0.0.1", link.local_port))
    await collector.until(lambda: len(collector.frames) == 1)
    assert link.state is LinkState.UP
    assert link.peers == {(1, 1): peer.getsockname()}
    frame, _ = await received(peer, 0)
    ours = decode(frame)
    assert (frame.system, frame.component, ours.type, ours.autopilot) == (253, 190, 6, 8)


def open_logs() -> list[str]:
    """Telemetry logs that this process has open."""
    found = []
    for descriptor in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # the listing's own
            found.append(os.readlink(f"/proc/self/fd/{descriptor}"))
    return [path for path in found if path.endswith(".tlog")]


async def test_everything_received_and_sent_is_in_the_tlog_where_the_batch_says(
    opened: Opener, peer: socket.socket
) -> None:
    link = await opened("udpin:127.0.0.1:0", ids=OwnIdentity(system=200, component=191))
    collector = Collector(link, frozenset({27}))
    for k in range(20):
        peer.sendto(encode(imu(k), 1, 1, k), ("127.0.0.1", link.local_port))
    peer.sendto(encode(dialect.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0), 1, 1, 20), ("127.0.0.1", link.local_port))
    await collector.until(lambda: len(collector.frames) == 20)
    await received(peer, 0)
    link.send(dialect.MAVLink_param_request_list_message(1, 1), (1, 1))
    await received(peer, 21)
    await link.tlog.sync()
    data = link.tlog.path.read_bytes()
    assert link.tlog.position == len(data)
    recorded = [frame for _, frame in iter_tlog(data)]
    assert [f.sequence for f in recorded if f.message_id == 27] == list(range(20))
    assert {(f.system, f.component) for f in recorded if f.message_id == 21} == {(200, 191)}
    assert sum(f.message_id == 74 for f in recorded) == 1
    for batch in collector.batches:
        inside = [f for _, f in iter_tlog(data[batch.tlog_start : batch.tlog_end])]
        assert [f for f in inside if f.message_id == 27] == list(batch.frames)


async def test_a_link_goes_on_in_another_file_and_nothing_is_lost_between_them(
    opened: Opener, peer: socket.socket, tmp_path: Path
) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link, frozenset({27}))
    first, marks = link.tlog, []
    for k in range(240):
        peer.sendto(encode(imu(k), 1, 1, k), ("127.0.0.1", link.local_port))
        if k % 60 == 59:
            assert link.rotate()
            path = link.tlog.path
            link.mark(lambda byte, path=path: marks.append((path, byte)))
            await asyncio.sleep(0.02)
    await collector.until(lambda: len(collector.frames) == 240 and len(marks) == 4)
    files = sorted(tmp_path.glob("*.tlog"))  # noqa: ASYNC240 - small
    recorded = [record for path in files for record in iter_tlog(path.read_bytes())]
    assert [f.sequence for _, f in recorded if f.message_id == 27] == list(range(240))
    assert [t for t, _ in recorded] == sorted(t for t, _ in recorded)
    assert (files[0], files[-1], len(files)) == (first.path, link.tlog.path, 5)
    assert link.tlog.position == link.tlog.path.stat().st_size
    assert [path for path, _ in marks] == files[1:]
    assert all(TlogReader(path.read_bytes()[byte:]).skipped_bytes == 0 for path, byte in marks)
    assert open_logs() == [str(link.tlog.path)]


async def test_batches_of_two_files_are_not_joined(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link, frozenset({27}))
    for k in range(100):
        peer.sendto(encode(imu(k), 1, 1, k), ("127.0.0.1", link.local_port))
        if k == 50:
            time.sleep(0.1)  # noqa: ASYNC251 - the loop is late: what has come meanwhile is joined
            link.rotate()
            time.sleep(0.1)  # noqa: ASYNC251 - likewise
    await collector.until(lambda: len(collector.frames) == 100)
    assert all(batch.tlog_start < batch.tlog_end for batch in collector.batches)


async def test_a_file_that_somebody_needs_unbroken_is_gone_on_with(opened: Opener) -> None:
    link = await opened("udpin:127.0.0.1:0")
    path = link.tlog.path
    with link.unbroken():
        with link.unbroken():
            assert not link.rotate()
        assert not link.rotate()
    assert link.tlog.path == path
    assert link.rotate()
    assert link.tlog.path != path
    await link.close()
    assert not link.rotate()


async def test_a_second_vehicles_torn_datagrams_cost_the_first_nothing(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    with second_socket() as other:
        for k in range(200):
            peer.sendto(encode(imu(k), 1, 1, k), ("127.0.0.1", link.local_port))
            whole = encode(imu(k), 2, 1, k)
            other.sendto(whole[:-7] if k % 5 == 0 else whole, ("127.0.0.1", link.local_port))
            if k % 50 == 49:
                await asyncio.sleep(0)
        other.sendto(b"\xfd\xff\x00", ("127.0.0.1", link.local_port))  # claims 267 bytes that never come
        peer.sendto(encode(imu(200), 1, 1, 200), ("127.0.0.1", link.local_port))
        await collector.until(lambda: len(collector.frames) >= 361)
    assert sum(f.system == 1 for f in collector.frames) == 201
    assert sum(f.system == 2 for f in collector.frames) == 160
    assert link.statistics(1, 1).lost == 0
    assert link.statistics(2, 1).lost == 39  # the first of them came before any sequence was known


async def test_messages_reach_the_vehicle_they_are_for(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    with second_socket() as other:
        peer.sendto(encode(heartbeat(), 1, 1, 0), ("127.0.0.1", link.local_port))
        other.sendto(encode(heartbeat(), 2, 1, 0), ("127.0.0.1", link.local_port))
        await collector.until(lambda: len(collector.frames) == 2)
        link.send(dialect.MAVLink_param_request_list_message(2, 1), (2, 1))
        link.send(dialect.MAVLink_param_request_read_message(1, 1, b"A", -1), (1, 1))
        assert await everything(other) == {21}
        assert await everything(peer) == {20}
    with pytest.raises(LinkDown, match="system id 9"):
        link.send(heartbeat(), (9, 1))


async def test_a_vehicle_that_changes_its_address_and_two_that_share_an_id_are_told(
    opened: Opener, peer: socket.socket
) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    to = ("127.0.0.1", link.local_port)
    with second_socket() as other:
        peer.sendto(encode(heartbeat(), 1, 1, 0), to)
        await collector.until(lambda: len(collector.frames) == 1)
        other.sendto(encode(heartbeat(), 1, 1, 1), to)
        await collector.until(lambda: any(e.kind is LinkEventKind.PEER_CHANGED for e in collector.events))
        (moved,) = [e for e in collector.events if e.kind is LinkEventKind.PEER_CHANGED]
        assert moved.addresses == (peer.getsockname(), other.getsockname())
        peer.sendto(encode(heartbeat(), 1, 1, 2), to)
        await collector.until(lambda: any(e.kind is LinkEventKind.DUPLICATE_SYSTEM for e in collector.events))


async def test_our_own_ids_from_elsewhere_are_told_and_not_believed(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    peer.sendto(encode(heartbeat(), 253, 190, 0), ("127.0.0.1", link.local_port))
    await collector.until(lambda: any(e.kind is LinkEventKind.OWN_IDS_HEARD for e in collector.events))
    assert collector.frames == []


async def test_a_busy_port_is_refused_with_the_remedy(opened: Opener, peer: socket.socket) -> None:
    port = peer.getsockname()[1]
    with pytest.raises(PortBusy, match=f"another program uses port {port}"):
        await opened(f"udpin:127.0.0.1:{port}")


async def test_a_host_that_is_not_there_is_refused(opened: Opener) -> None:
    with pytest.raises(EndpointError, match="no address"):
        await opened("udpin:203.0.113.1:14550")


async def test_tcp_end_is_noticed_and_the_link_connects_again(opened: Opener) -> None:
    connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
    server = await asyncio.start_server(lambda r, w: connections.put_nowait((r, w)), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    link = await opened(f"tcp:127.0.0.1:{port}")
    collector = Collector(link)
    assert link.state is LinkState.UP
    _, writer = await connections.get()
    stream = b"".join(encode(imu(k), 1, 1, k) for k in range(100))
    writer.write(stream[:1111])
    await writer.drain()
    writer.write(stream[1111:])
    await collector.until(lambda: len(collector.frames) == 100)
    writer.close()
    await collector.until(lambda: link.state is LinkState.DOWN)
    assert "closed the connection" in link.reason
    with pytest.raises(LinkDown, match="closed the connection"):
        link.send(heartbeat())
    reader, writer = await asyncio.wait_for(connections.get(), scaled(5))
    await collector.until(lambda: link.state is LinkState.UP)
    assert (await asyncio.wait_for(reader.readexactly(21), scaled(5)))[0] == 0xFD
    writer.close()
    server.close()
    await server.wait_closed()


async def test_a_tcp_port_nobody_listens_on_is_down_with_the_reason_and_tried_again(opened: Opener) -> None:
    with socket.socket() as placeholder:
        placeholder.bind(("127.0.0.1", 0))
        port = placeholder.getsockname()[1]
    link = await opened(f"tcp:127.0.0.1:{port}")
    collector = Collector(link)
    assert link.state is LinkState.DOWN
    assert "refused" in link.reason
    accepted = asyncio.Event()
    server = await asyncio.start_server(lambda _r, w: (accepted.set(), w.close())[1], "127.0.0.1", port)
    await collector.until(accepted.is_set)
    server.close()
    await server.wait_closed()


async def test_a_tcp_server_link_serves_who_connects(opened: Opener) -> None:
    link = await opened("tcpin:127.0.0.1:0")
    collector = Collector(link)
    reader, writer = await asyncio.open_connection("127.0.0.1", link.local_port)
    writer.write(encode(imu(), 1, 1, 0))
    await collector.until(lambda: len(collector.frames) == 1)
    link.send(dialect.MAVLink_param_request_list_message(1, 1), (1, 1))
    parser = FrameParser()
    async with asyncio.timeout(scaled(5)):
        while not any(f.message_id == 21 for f in parser.feed(await reader.read(100))):
            pass
    writer.close()
    await writer.wait_closed()


async def test_a_recording_is_replayed_completely(opened: Opener, tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(tlog_record(10**15 + k, encode(imu(k), 1, 1, k)) for k in range(1000)))
    link = Link("replay", f"file:{path}?speed=0", tlog_dir=tmp_path)
    collector = Collector(link)  # before it is opened: a replay waits for nobody
    await link.open()
    await collector.until(lambda: len(collector.frames) == 1000)
    await collector.until(lambda: link.state is LinkState.DOWN)
    assert "ended" in link.reason
    with pytest.raises(LinkDown):
        link.send(heartbeat(), (1, 1))
    await link.close()


@pytest.mark.parametrize(("content", "why"), [(None, "cannot be read"), (b"nothing of the kind", "no MAVLink frame")])
async def test_a_file_that_is_no_recording_is_refused(
    opened: Opener, tmp_path: Path, content: bytes | None, why: str
) -> None:
    path = tmp_path / "x.tlog"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(EndpointError, match=why):
        await opened(f"file:{path}")


@pytest.mark.parametrize("kind", ["device", "pipe", "folder"])
async def test_what_might_have_no_end_is_refused(opened: Opener, tmp_path: Path, kind: str) -> None:
    path = {"device": Path("/dev/zero"), "pipe": tmp_path / "pipe", "folder": tmp_path}[kind]
    if kind == "pipe":
        os.mkfifo(path)
    with pytest.raises(EndpointError, match=r"no regular file|directory"):
        await opened(f"file:{path}")


async def test_a_full_disk_is_told_and_recording_goes_on_afterwards(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    to = ("127.0.0.1", link.local_port)
    peer.sendto(encode(imu(), 1, 1, 0), to)
    await collector.until(lambda: len(collector.frames) == 1)
    recorder = link.tlog
    good = recorder._file
    recorder._file = os.open("/dev/full", os.O_WRONLY)
    before = recorder.position
    peer.sendto(encode(imu(), 1, 1, 1), to)
    await collector.until(lambda: len(collector.frames) == 2)
    assert "Free some space" in str(collector.batches[-1].tlog_error)
    await collector.until(lambda: any(e.kind is LinkEventKind.TLOG for e in collector.events))
    os.close(recorder._file)
    recorder._file, recorder._retry_at = good, 0.0
    recorder.position = before
    peer.sendto(encode(imu(), 1, 1, 2), to)
    await collector.until(lambda: len(collector.frames) == 3)
    assert collector.batches[-1].tlog_error is None


async def test_signed_links_believe_only_signed_frames_and_keep_the_time_stamp(
    opened: Opener, peer: socket.socket
) -> None:
    stored: list[int] = []
    link = await opened("udpin:127.0.0.1:0", signing=SigningConfig(KEY, link_id=2), store_timestamp=stored.append)
    collector = Collector(link)
    to = ("127.0.0.1", link.local_port)
    future = 10**12
    peer.sendto(encode(imu(1), 1, 1, 0), to)
    peer.sendto(encode(imu(2), 1, 1, 0, Signing(bytes(32), 1, future)), to)
    peer.sendto(encode(imu(3), 1, 1, 0, Signing(KEY, 1, 5 * 10**11)), to)
    peer.sendto(encode(imu(4), 1, 1, 1, Signing(KEY, 1, 5 * 10**11 + 1)), to)
    await collector.until(lambda: len(collector.frames) == 2)
    assert [decode(f).xacc for f in collector.frames] == [3, 4]
    await collector.until(lambda: any(e.kind is LinkEventKind.SIGNATURE_REFUSED for e in collector.events))
    frame, _ = await received(peer, 0)
    assert check_signature(frame, KEY)
    await collector.until(lambda: bool(stored))
    assert 5 * 10**11 < stored[-1] < future


async def test_the_loss_count_is_the_truth_beyond_256(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    collector = Collector(link)
    to = ("127.0.0.1", link.local_port)
    for system in range(1, 6):
        sequence, last, longest = 0, time.monotonic(), 0.0
        for k in range(60):  # about 200 frames a second, then a gap of 0.3 s in which 60 are lost
            if k == 30:
                sequence += 60
                await asyncio.sleep(0.3)
            longest, last = max(longest, time.monotonic() - last), time.monotonic()
            peer.sendto(encode(imu(k), system, 1, sequence & 0xFF), to)
            sequence += 1
            await asyncio.sleep(0.005)
        await collector.until(lambda system=system: sum(f.system == system for f in collector.frames) == 60)
        if longest < 0.8:  # else the machine has stood still, and as many as 256 may be missing for all that is known
            break
    statistics = link.statistics(system, 1)
    assert (statistics.received, statistics.lost) == (60, 60)


async def test_a_subscriber_that_fails_takes_nothing_from_the_others(opened: Opener, peer: socket.socket) -> None:
    failures: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: failures.append(context))
    link = await opened("udpin:127.0.0.1:0")

    def broken(_batch: Batch) -> None:
        raise RuntimeError("broken")

    link.subscribe(broken)
    collector = Collector(link)
    peer.sendto(encode(imu(), 1, 1, 0), ("127.0.0.1", link.local_port))
    await collector.until(lambda: len(collector.frames) == 1)
    assert [str(f["exception"]) for f in failures] == ["broken"]


@pytest.fixture
def wire_to_device() -> Any:
    """A pair of pseudo terminals: the far end of a serial line, and the name of the near one."""
    far, near = os.openpty()
    tty.setraw(far)
    tty.setraw(near)
    os.set_blocking(far, False)
    yield far, os.ttyname(near)
    os.close(near)
    with suppress(OSError):
        os.close(far)


async def test_a_serial_line_both_ways_and_its_unplugging(opened: Opener, wire_to_device: Any) -> None:
    far, device = wire_to_device
    link = await opened(f"serial:{device}:57600")
    collector = Collector(link)
    stream = b"".join(encode(imu(k), 1, 1, k) for k in range(50))
    os.write(far, b"\x00noise" + stream[:700])
    await asyncio.sleep(0.05)
    os.write(far, stream[700:])
    await collector.until(lambda: len(collector.frames) == 50)
    assert link.statistics(1, 1).lost == 0
    parser, heard = FrameParser(), list[Frame]()
    link.send(dialect.MAVLink_param_request_list_message(1, 1), (1, 1))
    async with asyncio.timeout(scaled(5)):
        while not any(frame.message_id == 21 for frame in heard):
            await asyncio.sleep(0.01)
            with suppress(BlockingIOError):
                heard += parser.feed(os.read(far, 4096))
    with pytest.raises(PortBusy, match="another program"):
        await opened(f"serial:{device}:57600")
    os.close(far)
    await collector.until(lambda: link.state is LinkState.DOWN)
    assert "gone" in link.reason


async def test_a_device_that_is_not_there_is_down_and_waited_for(opened: Opener, tmp_path: Path) -> None:
    link = await opened(f"serial:{tmp_path}/ttyACM0:57600")
    assert link.state is LinkState.DOWN
    assert "plugged in" in link.reason


async def test_nothing_is_left_of_a_closed_link(opened: Opener, peer: socket.socket) -> None:
    link = await opened("udpin:127.0.0.1:0")
    port = link.local_port
    await link.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("link-")]
    await opened(f"udpin:127.0.0.1:{port}")
    with pytest.raises(LinkDown, match="closed"):
        link.send(heartbeat())


@pytest.mark.shared
async def test_a_real_capture_is_replayed_frame_by_frame(tmp_path: Path, shared_data: Path) -> None:
    path = shared_data / "px4_captures" / "set_nan_inf.tlog"
    link = Link("replay", f"file:{path}?speed=0", tlog_dir=tmp_path)
    collector = Collector(link)
    await link.open()
    truth = [frame.raw for _, frame in iter_tlog(path.read_bytes())]
    await collector.until(lambda: link.state is LinkState.DOWN and len(collector.frames) >= len(truth))
    await link.close()
    assert [frame.raw for frame in collector.frames] == truth
    assert [frame.raw for _, frame in iter_tlog(link.tlog.path.read_bytes())] == truth
