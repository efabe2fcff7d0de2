"""Clients that cost much: slow bodies, and event streams by the thousand."""

from __future__ import annotations

import asyncio
import resource
import time
from pathlib import Path

import pytest

from tests.patience import scaled

from .api_bench import Api, served

STREAMS = 1000
HALF_OPEN = 200
ALLOWED = 16


def memory_mib() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


async def raw(a: Api, head: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    port = a.client.base_url.port
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(head.replace("HOST", f"Host: 127.0.0.1:{port}").encode())
    return reader, writer


async def trickled(a: Api, path: str) -> bytes:
    """The answer to a body that comes drop by drop; asked again where a drop after the answer reset the connection."""
    while True:
        reader, writer = await raw(a, f"POST {path} HTTP/1.1\r\nHOST\r\nContent-Length: 1000000\r\n\r\n")

        async def trickle(to: asyncio.StreamWriter = writer) -> None:
            while True:
                to.write(b"1")
                await asyncio.sleep(0.05)

        dripping = asyncio.create_task(trickle())
        try:
            async with asyncio.timeout(scaled(30)):
                return await reader.read()
        except ConnectionResetError:
            continue
        finally:
            dripping.cancel()
            writer.close()


async def test_a_body_that_trickles_is_given_up(tmp_path: Path) -> None:
    async with served(tmp_path, limits={"body_window_s": 0.5}) as a:
        for path in ("/api/v1/recordings?name=a.csv", "/api/v1/links"):
            answer = await trickled(a, path)
            assert answer.startswith(b"HTTP/1.1 408"), answer
            assert b"less than 1000 bytes/s" in answer
        assert list((tmp_path / "recordings").iterdir()) == []


@pytest.mark.parametrize("head", ["", "GET /api/v1/li", "GET /api/v1/links HTTP/1.1\r\nHOST\r\nX: "])
async def test_connections_that_never_finish_asking_are_cut_off(tmp_path: Path, head: str) -> None:
    async with served(tmp_path, limits={"head_s": 1.0}) as a:
        opened = [await raw(a, head) for _ in range(HALF_OPEN)]

        async def trickle() -> None:
            while True:
                for _, writer in opened:
                    writer.write(b"x" if head else b"")
                await asyncio.sleep(0.1)

        dripping = asyncio.create_task(trickle())
        async with asyncio.timeout(scaled(5)):
            await a.get("/links")
        async with asyncio.timeout(scaled(20)):
            assert [await _rest(reader) for reader, _ in opened] == [b""] * HALF_OPEN
        dripping.cancel()
        for _, writer in opened:
            writer.close()


async def test_only_so_many_may_be_half_open_and_who_asks_at_once_is_answered(tmp_path: Path) -> None:
    async with served(tmp_path, limits={"head_s": 600.0, "heads": 20}) as a:
        opened = [await raw(a, "GET / HTTP/1.1\r\nX: ") for _ in range(HALF_OPEN)]
        async with asyncio.timeout(scaled(5)):
            for _ in range(30):
                await a.get("/links")
        async with asyncio.timeout(scaled(20)):
            assert [await _rest(reader) for reader, _ in opened[:-20]] == [b""] * (HALF_OPEN - 20)
        assert not opened[-1][0].at_eof()
        for _, writer in opened:
            writer.close()


async def test_the_next_request_of_a_connection_must_be_finished_too(tmp_path: Path) -> None:
    async with served(tmp_path, limits={"head_s": 1.0}) as a:
        reader, writer = await raw(a, "GET /healthz HTTP/1.1\r\nHOST\r\n\r\n")
        async with asyncio.timeout(scaled(20)):
            assert b"200" in await reader.readline()
            writer.write(b"GET /healthz HTTP/1.1\r\nX: ")
            await _rest(reader)
        writer.close()


@pytest.mark.parametrize(
    "piece",
    ["GET /healthz?" + "x" * 200_000, "GET /healthz HTTP/1.1\r\nHOST\r\nX-Long: " + "x" * 200_000,
     "GET /healthz HTTP/1.1\r\nHOST\r\n" + "".join(f"X-{k}: {'y' * 100}\r\n" for k in range(2000)) + "\r\n"],
    ids=["an address", "a value", "many headers"],
)  # fmt: skip
async def test_a_head_of_a_request_has_a_largest_size(tmp_path: Path, piece: str) -> None:
    async with served(tmp_path) as a:
        reader, writer = await raw(a, piece)
        async with asyncio.timeout(scaled(30)):
            answer = await _rest(reader)
        assert answer.startswith(b"HTTP/1.1 431") or not answer  # the rest of it came on a closed connection
        writer.close()
        fitting = "GET /healthz HTTP/1.1\r\nHOST\r\nX-Long: " + "x" * 30_000 + "\r\n\r\n"
        for _ in range(2):
            reader, writer = await raw(a, fitting)
            async with asyncio.timeout(scaled(30)):
                assert (await reader.readline()).startswith(b"HTTP/1.1 200")
            writer.close()


async def _rest(reader: asyncio.StreamReader) -> bytes:
    """What comes until the server closes the connection."""
    try:
        return await reader.read()
    except ConnectionResetError:
        return b""


async def test_a_slow_upload_that_goes_on_is_taken(tmp_path: Path) -> None:
    """Over more than two windows; whatever comes first in a window is enough for it, should the machine be late."""
    body = b"mag_x,mag_y,mag_z\n" + b"1,2,3\n4,5,7\n" * 8000
    async with served(tmp_path, limits={"body_window_s": 1.0}) as a:
        head = f"POST /api/v1/recordings?name=a.csv HTTP/1.1\r\nHOST\r\nContent-Length: {len(body)}\r\n\r\n"
        reader, writer = await raw(a, head)
        for i in range(0, len(body), 2000):
            writer.write(body[i : i + 2000])
            await asyncio.sleep(0.05)
        async with asyncio.timeout(scaled(30)):
            assert (await reader.readline()).startswith(b"HTTP/1.1 201")
        writer.close()


async def test_a_thousand_event_streams_leave_room_for_everybody_else(tmp_path: Path) -> None:
    async with served(tmp_path, limits={"streams": ALLOWED}) as a:
        await a.get("/links")
        before, opened = memory_mib(), []
        statuses = []
        for _ in range(STREAMS):
            reader, writer = await raw(a, "GET /api/v1/events HTTP/1.1\r\nHOST\r\n\r\n")
            opened.append(writer)
            async with asyncio.timeout(scaled(30)):
                statuses.append(int((await reader.readline()).split()[1]))
        assert statuses == [200] * ALLOWED + [503] * (STREAMS - ALLOWED)
        used = time.process_time()
        for _ in range(50):
            await a.get("/links")
        assert (time.process_time() - used) / 50 < 0.1  # of a processor, both ends together
        assert memory_mib() - before < 100
        for writer in opened:
            writer.close()
        async with asyncio.timeout(scaled(30)):
            status = 503
            while status != 200:  # a place is free again
                await asyncio.sleep(0.1)
                reader, writer = await raw(a, "GET /api/v1/events HTTP/1.1\r\nHOST\r\n\r\n")
                status = int((await reader.readline()).split()[1])
                writer.close()
