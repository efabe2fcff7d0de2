"""Uploads: what is kept of them, and what is not."""

from __future__ import annotations

import asyncio
import errno
import hashlib
from contextlib import ExitStack

import pytest

from mavcal.calib.errors import UnreadableError
from mavcal.service.children import INSPECT, SERIES
from mavcal.service.errors import ChildEnded, DiskFull, RecordingUnknown, StoreError, UploadError, UploadTooLarge
from mavcal.service.recordings import Recordings
from tests.unit.uploads import IDENTITY, LIMITS, Runs, chunks, uploads_of


@pytest.fixture
def uploads(tmp_path):
    """Makes the uploads of a folder, with children that answer so."""
    with ExitStack() as stack:

        def make(*, limit_bytes=1000, **answers):
            children = Runs(**answers)
            found = stack.enter_context(uploads_of(tmp_path / "up", children, limit_bytes=limit_bytes))
            found.children = children
            return found

        yield make


def left(tmp_path):
    return [path.name for path in (tmp_path / "up").glob("*")]


async def test_an_upload_is_kept_with_its_digest_and_what_is_in_it(uploads, tmp_path):
    found = uploads()
    row = await found.add("/home/me/A flight.BIN", chunks(b"ab", b"", b"c"), {"unit_accel": "g"})
    assert (row.name, row.size, row.sha256) == ("A flight.BIN", 3, hashlib.sha256(b"abc").hexdigest())
    assert row.body == {"reading": {"unit_accel": "g"}, "inspection": {"channels": [], **IDENTITY, "source": row.name}}
    assert (row.path.read_bytes(), row.path.suffix) == (b"abc", ".bin")
    [(task, order, limits)] = found.children.asked
    assert (task, order, limits) == (INSPECT, {"path": str(row.path), "reading": {"unit_accel": "g"}}, LIMITS)
    assert found.get(row.id) == row
    assert found.all() == (row,)


async def test_two_uploads_of_one_name_are_two(uploads):
    found = uploads()
    first, second = [await found.add("a.bin", chunks(b"x"), {}) for _ in range(2)]
    assert first.id != second.id
    assert first.path != second.path


@pytest.mark.parametrize(
    ("name", "suffix"),
    [("a.csv", ".csv"), ("a.tar.gz", ".gz"), ("a", ""), ("a.b c", ""), ("a.verylongone", ""), ("..", ""), ("a.", "")],
)
async def test_only_a_plain_ending_is_kept_of_a_name(uploads, name, suffix):
    row = await uploads().add(name, chunks(b"x"), {})
    assert row.path.suffix == suffix


@pytest.mark.parametrize(
    ("limit", "parts", "error"),
    [(3, (b"ab", b"cd"), UploadTooLarge), (3, (), UploadError), (3, (b"",), UploadError), (3, (b"abc",), None)],
)
async def test_an_upload_is_as_large_as_its_limit_and_not_empty(uploads, tmp_path, limit, parts, error):
    found = uploads(limit_bytes=limit)
    if error is None:
        await found.add("a.bin", chunks(*parts), {})
        return
    with pytest.raises(error):
        await found.add("a.bin", chunks(*parts), {})
    assert left(tmp_path) == []
    assert found.children.asked == []


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (lambda order: UnreadableError(f"{order['path']} has no header"), UploadError),
        (ChildEnded("it took too long"), ChildEnded),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
async def test_what_cannot_be_read_leaves_nothing(uploads, tmp_path, answer, error):
    found = uploads(**{INSPECT: answer})
    with pytest.raises(error) as raised:
        await found.add("flight.bin", chunks(b"x"), {})
    assert left(tmp_path) == []
    assert found.all() == ()
    assert str(tmp_path) not in str(raised.value)
    if error is UploadError:
        assert str(raised.value) == "flight.bin has no header"


@pytest.mark.parametrize(
    ("number", "error"), [(errno.ENOSPC, DiskFull), (errno.EDQUOT, DiskFull), (errno.EIO, OSError)]
)
async def test_a_full_disk_is_said(uploads, tmp_path, number, error):
    found = uploads()

    async def broken():
        yield b"x"
        raise OSError(number, "no")

    with pytest.raises(error) as raised:
        await found.add("a.bin", broken(), {})
    assert isinstance(raised.value, StoreError) is (error is DiskFull)
    assert left(tmp_path) == []


async def test_an_upload_is_where_the_folder_is_now(uploads, tmp_path):
    found = uploads()
    row = await found.add("a.bin", chunks(b"x"), {})
    elsewhere = Recordings(found._store, tmp_path / "b", limit_bytes=1, children=found.children, limits=LIMITS)
    assert elsewhere.get(row.id).path == tmp_path / "b" / row.path.name
    elsewhere.close()
    with pytest.raises(RecordingUnknown, match="there is no recording gone"):
        found.get("gone")


async def test_the_series_of_an_upload_are_read_with_its_own_options(uploads):
    found = uploads(**{SERIES: {"series": [{"sensor": "gyro"}]}})
    row = await found.add("a.bin", chunks(b"x"), {"rate": 50.0})
    assert await found.series(row.id) == [{"sensor": "gyro"}]
    assert found.children.asked[-1] == (SERIES, {"path": str(row.path), "reading": {"rate": 50.0}}, LIMITS)
    found.children.answers[SERIES] = lambda order: UnreadableError(f"{order['path']} was cut")
    with pytest.raises(UploadError, match=r"^a\.bin was cut$"):
        await found.series(row.id)


async def test_an_upload_that_is_given_up_leaves_nothing(uploads, tmp_path):
    async def slow():
        yield b"x"
        await asyncio.Event().wait()

    adding = asyncio.ensure_future(uploads().add("a.bin", slow(), {}))
    while not left(tmp_path):  # noqa: ASYNC110 - a thread makes the folder
        await asyncio.sleep(0)
    adding.cancel()
    with pytest.raises(asyncio.CancelledError):
        await adding
    assert left(tmp_path) == []
