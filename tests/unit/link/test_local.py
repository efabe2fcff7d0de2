"""Transports of this machine: a serial line, a recording that is replayed, and what starts a simulated vehicle."""

from __future__ import annotations

import errno
import os
import selectors
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.frames import FrameParser
from mavcal.calib.wire.tlog import tlog_record
from mavcal.service.errors import EndpointError, LinkDown, LinkError, PortBusy
from mavcal.service.link import local
from mavcal.service.link.endpoint import Endpoint, EndpointKind, parse_endpoint
from mavcal.service.link.local import FileTransport, SerialTransport, SimTransport
from mavcal.service.link.transports import Disconnected
from tests.patience import patience


class ManualClock:
    """A monotonic clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def selector() -> Iterator[selectors.BaseSelector]:
    with selectors.DefaultSelector() as made:
        yield made


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    made = ManualClock()
    monkeypatch.setattr(local, "time", made)
    return made


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The other end of a serial line, and the name of its device here."""
    end, device = os.openpty()
    tty.setraw(device)
    yield end, os.ttyname(device)
    os.close(device)
    os.close(end)


def frame(number: int) -> bytes:
    return encode(RawMessage(0, bytes(8) + b"\x03"), 1, 1, number & 0xFF)


def tlog(path: Path, times_s: list[float]) -> Path:
    path.write_bytes(b"".join(tlog_record(10**15 + round(t * 1e6), frame(n)) for n, t in enumerate(times_s)))
    return path


def replayed(path: Path, options: str = "") -> FileTransport:
    return FileTransport(parse_endpoint(f"file:{path}{options}"))


def numbers(transport: FileTransport) -> list[int]:
    """Sequence numbers of the frames that are due."""
    data = b"".join(chunk.data for chunk in transport.receive())
    return [found.sequence for found in FrameParser().feed(data)]


def test_a_recording_is_replayed_at_its_own_pace(
    tmp_path: Path, selector: selectors.BaseSelector, clock: ManualClock
) -> None:
    transport = replayed(tlog(tmp_path / "a.tlog", [0.0, 0.2, 0.2, 5.0]))
    assert transport.receive() == []  # not open yet
    transport.open(selector)
    assert (transport.wait(), numbers(transport)) == (0.0, [0])
    assert transport.wait() == pytest.approx(0.2)
    clock.now += 0.19
    assert numbers(transport) == []
    clock.now += 0.02
    assert numbers(transport) == [1, 2]
    assert transport.wait() == 1.0  # a stop is noticed within a second, however long the pause
    clock.now += 60.0
    assert numbers(transport) == [3]
    with pytest.raises(Disconnected, match="the recording has ended"):
        transport.receive()
    assert transport.wait() == 1.0


@pytest.mark.parametrize(("speed", "due"), [(2.0, 0.1), (0.5, 0.4), (10.0, 0.02)])
def test_the_speed_divides_the_time_between_frames(
    tmp_path: Path, selector: selectors.BaseSelector, clock: ManualClock, speed: float, due: float
) -> None:
    transport = replayed(tlog(tmp_path / "a.tlog", [0.0, 0.2]), f"?speed={speed}")
    transport.open(selector)
    transport.receive()
    assert transport.wait() == pytest.approx(due)


def test_without_a_pace_everything_comes_in_bites(
    tmp_path: Path, selector: selectors.BaseSelector, clock: ManualClock
) -> None:
    """The reader hands on what came between two bites, so that a long recording is not held in memory twice."""
    transport = replayed(tlog(tmp_path / "a.tlog", [3600.0 * k for k in range(450)]), "?speed=0")
    transport.open(selector)
    assert [len(numbers(transport)) for _ in range(3)] == [200, 200, 50]
    with pytest.raises(Disconnected):
        transport.receive()


def test_a_recording_whose_clock_goes_back_does_not_stop(
    tmp_path: Path, selector: selectors.BaseSelector, clock: ManualClock
) -> None:
    transport = replayed(tlog(tmp_path / "a.tlog", [10.0, 4.0, 10.5]))
    transport.open(selector)
    assert numbers(transport) == [0, 1]
    assert transport.wait() == pytest.approx(0.5)


def test_the_peer_of_a_recording_is_its_file_and_nothing_is_sent_there(
    tmp_path: Path, selector: selectors.BaseSelector
) -> None:
    path = tlog(tmp_path / "a.tlog", [0.0])
    before = path.read_bytes()
    transport = replayed(path)
    assert (transport.answers, transport.ends, transport.default_peer()) == (False, True, None)
    transport.open(selector)
    transport.send(b"x", None)
    assert [chunk.peer for chunk in transport.receive()] == [(str(path), 0)]
    assert path.read_bytes() == before
    transport.close()
    assert transport.receive() == []


@pytest.mark.parametrize("speed", ["-1", "inf", "nan"])
def test_a_speed_that_is_none_is_refused(tmp_path: Path, selector: selectors.BaseSelector, speed: str) -> None:
    transport = replayed(tlog(tmp_path / "a.tlog", [0.0]), f"?speed={speed}")
    with pytest.raises(EndpointError, match="the speed is a number from 0 on; 0 is as fast as possible"):
        transport.open(selector)


def test_what_cannot_be_replayed_is_said_to_be_so(tmp_path: Path, selector: selectors.BaseSelector) -> None:
    (tmp_path / "text.tlog").write_bytes(b"no frame at all " * 20)
    (tmp_path / "empty.tlog").write_bytes(b"")
    os.mkfifo(tmp_path / "pipe")  # to read it would never end
    for name, why in (
        ("none.tlog", "cannot be read: No such file or directory"),
        ("text.tlog", r"no MAVLink frame in this file; is it a \.tlog\?"),
        ("empty.tlog", "no MAVLink frame"),
        ("pipe", "cannot be read: it is no regular file"),
        ("", "is a directory|is no regular file"),
    ):
        with pytest.raises(EndpointError, match=f"(?i){why}"):
            replayed(tmp_path / name).open(selector)


def test_the_home_folder_may_be_written_short(
    tmp_path: Path, selector: selectors.BaseSelector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    tlog(tmp_path / "a.tlog", [0.0])
    transport = FileTransport(parse_endpoint("file:~/a.tlog"))
    transport.open(selector)
    assert numbers(transport) == [0]


def test_a_serial_line_is_read_and_written_without_waiting(
    selector: selectors.BaseSelector, line: tuple[int, str]
) -> None:
    end, device = line
    transport = SerialTransport(parse_endpoint(f"serial:{device}:57600"))
    assert transport.receive() == []
    transport.send(b"nobody", None)
    transport.open(selector)
    assert transport.receive() == []
    os.write(end, b"\x00\x11\x13\xfd")  # flow control characters are data
    got, limit = b"", patience(5)
    while len(got) < 4:
        assert not limit.over
        selector.select(0.05)
        chunks = transport.receive()
        assert {chunk.peer for chunk in chunks} <= {(device, 0)}
        got += b"".join(chunk.data for chunk in chunks)
    assert got == b"\x00\x11\x13\xfd"
    transport.send(b"answer\n", None)
    assert os.read(end, 100) == b"answer\n"
    assert transport.default_peer() == (device, 0)
    transport.close()
    transport.close()
    assert transport.receive() == []


def test_a_device_has_one_user(selector: selectors.BaseSelector, line: tuple[int, str]) -> None:
    endpoint = parse_endpoint(f"serial:{line[1]}:57600")
    first = SerialTransport(endpoint)
    first.open(selector)
    with pytest.raises(PortBusy, match=rf"another program uses {line[1]}\. Close it there first"):
        SerialTransport(endpoint).open(selector)
    first.close()


def test_a_device_that_was_pulled_out_ends_the_link(selector: selectors.BaseSelector) -> None:
    end, device = os.openpty()
    tty.setraw(device)
    transport = SerialTransport(parse_endpoint(f"serial:{os.ttyname(device)}:57600"))
    transport.open(selector)
    os.close(device)
    os.close(end)
    with pytest.raises(Disconnected, match="the device has gone"):
        transport.receive()
    with pytest.raises(Disconnected, match="the device has gone"):
        transport.send(b"x", None)
    transport.close()


@pytest.mark.parametrize(
    ("raised", "kind", "said"),
    [
        (serial.SerialException(errno.EBUSY, "busy"), PortBusy, "another program uses /dev/ttyACM0"),
        (serial.SerialException(errno.EACCES, "denied"), EndpointError, "Add this user to the group 'dialout'"),
        (serial.SerialException(errno.ENOENT, "none"), LinkDown, "Is the vehicle plugged in and powered"),
        (ValueError("Invalid baud rate: 1201"), EndpointError, "Invalid baud rate: 1201"),
    ],
)
def test_a_device_that_cannot_be_opened_says_what_helps(
    selector: selectors.BaseSelector,
    monkeypatch: pytest.MonkeyPatch,
    raised: Exception,
    kind: type[LinkError],
    said: str,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(kind, match=said) as refused:
        SerialTransport(parse_endpoint("serial:/dev/ttyACM0:57600")).open(selector)
    assert type(refused.value) is kind
    assert str(refused.value).startswith("serial:/dev/ttyACM0:57600: ")


def test_the_simulator_is_given_its_options_and_neither_the_key_nor_who_moves_it(
    monkeypatch: pytest.MonkeyPatch, selector: selectors.BaseSelector
) -> None:
    asked: list[list[str]] = []

    def refuse(command: list[str], **_: object) -> None:
        asked.append(command)
        raise OSError("no more processes")

    monkeypatch.setattr(local.subprocess, "Popen", refuse)
    transport = SimTransport(parse_endpoint("sim:px4?seed=3&system_id=7&hand=mouse&signing=boat"))
    with pytest.raises(EndpointError, match="the simulated vehicle did not start: no more processes"):
        transport.open(selector)
    (command,) = asked
    assert command[command.index("--autopilot") + 1] == "px4"
    assert command[-4:] == ["--seed", "3", "--system-id", "7"]
    assert not {"mouse", "boat", "--hand", "--signing"} & set(command)
    assert transport._socket is None  # what was bound for it is closed


def test_a_simulator_that_refuses_its_options_is_quoted(selector: selectors.BaseSelector) -> None:
    endpoint = Endpoint(EndpointKind.SIM, autopilot="px4", options=(("seed", "many"),))
    transport = SimTransport(endpoint)
    with pytest.raises(EndpointError, match=r"(?s)sim:px4\?seed=many: the simulated vehicle did not start: .*many"):
        transport.open(selector)
    assert transport._child is None
