from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.tlog import TlogReader
from mavcal.service.errors import StoreError
from mavcal.service.link.recorder import TlogRecorder


def frame(number: int) -> bytes:
    return encode(RawMessage(0, bytes(8) + b"\x03"), 1, 1, number)


def sequences(path: Path) -> list[int]:
    reader = TlogReader(path.read_bytes())
    numbers = [found.sequence for _, found in reader]
    assert reader.skipped_bytes == 0
    return numbers


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Files of this process cannot grow beyond this, as on a full disk: a write ends half way."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[TlogRecorder]:
    made = TlogRecorder(tmp_path / "new" / "link.tlog")
    yield made
    made.close()


def records(recorder: TlogRecorder, numbers: range) -> list[bytes]:
    return [part for number in numbers for part in (recorder.stamp(), frame(number))]


def test_records_are_in_the_file_as_soon_as_they_are_written(recorder: TlogRecorder) -> None:
    recorder.write(records(recorder, range(3)))
    assert sequences(recorder.path) == [0, 1, 2]
    assert recorder.position == recorder.path.stat().st_size


def test_a_write_that_ends_half_way_leaves_no_torn_record_and_is_tried_again(recorder: TlogRecorder) -> None:
    recorder.write(records(recorder, range(2)))
    with file_size_limit(recorder.position + 40):
        recorder.write(records(recorder, range(2, 6)))
        assert recorder.error is not None
        assert "Free some space" in str(recorder.error)
        assert sequences(recorder.path) == [0, 1]
        recorder.write(records(recorder, range(6, 8)))  # within a second nothing is tried
    assert sequences(recorder.path) == [0, 1]
    recorder._retry_at = 0.0
    recorder.write(records(recorder, range(8, 9)))
    assert recorder.error is None
    assert sequences(recorder.path) == [0, 1, 8]
    assert recorder.position == recorder.path.stat().st_size


def test_times_never_decrease(recorder: TlogRecorder, monkeypatch: pytest.MonkeyPatch) -> None:
    clock: Callable[[], int] = iter([5_000_000_000_000, 4_000_000_000_000, 6_000_000_000_000]).__next__
    monkeypatch.setattr("mavcal.service.link.recorder.time.time_ns", clock)
    stamps = [int.from_bytes(recorder.stamp(), "big") for _ in range(3)]
    assert stamps == [5_000_000_000, 5_000_000_000, 6_000_000_000]


def test_a_place_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StoreError, match="cannot record"):
        TlogRecorder(tmp_path / "file" / "link.tlog")


async def test_sync_brings_it_onto_the_disk(recorder: TlogRecorder) -> None:
    recorder.write(records(recorder, range(1)))
    await recorder.sync()
    assert sequences(recorder.path) == [0]
