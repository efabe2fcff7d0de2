"""Children: their limits, their ends, and that none outlives the service."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.service.children import Children, Limits
from mavcal.service.errors import ChildEnded, ChildrenBusy
from tests.patience import scaled

TASKS = "tests.service.child_tasks"
PLENTY = Limits(2**30, 60.0, 60.0)
ROOT = Path(__file__).resolve().parents[2]


@asynccontextmanager
async def children(folder: Path, most: int = 2) -> AsyncIterator[Children]:
    made = Children(folder / "children", most=most, first=(), later=())
    try:
        yield made
    finally:
        await made.stop()


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


async def pid_in(path: Path) -> int:
    def read() -> str:
        return path.read_text() if path.exists() else ""

    async with asyncio.timeout(scaled(60)):
        while not (said := read()):  # noqa: ASYNC110 - another process says it
            await asyncio.sleep(0.02)
    return int(said)


async def gone(pid: int) -> None:
    async with asyncio.timeout(scaled(30)):
        while alive(pid):  # noqa: ASYNC110 - the kernel tells nobody
            await asyncio.sleep(0.02)


async def test_what_is_needed_later_is_loaded_while_nothing_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "mavcal_mark.py").write_text(f"open({str(tmp_path / 'loaded')!r}, 'w').close()\n")
    made = Children(tmp_path / "children", most=2, first=(), later=("mavcal_mark",))
    try:
        hanging = asyncio.create_task(made.run(f"{TASKS}:hang", {"pid": str(tmp_path / "pid")}, PLENTY))
        await pid_in(tmp_path / "pid")
        await asyncio.sleep(2.5)  # longer than the quiet that it waits for
        assert not (tmp_path / "loaded").exists()
        hanging.cancel()
        await asyncio.gather(hanging, return_exceptions=True)
        async with asyncio.timeout(scaled(30)):
            while not (tmp_path / "loaded").exists():  # noqa: ASYNC110 - another process writes it
                await asyncio.sleep(0.05)
    finally:
        await made.stop()


async def test_a_task_gets_its_order_and_its_result_comes_back_as_data(tmp_path):
    told: list[str] = []
    async with children(tmp_path) as c:
        order = {"path": "ä\ud800", "number": 0.1, "list": [1, None]}
        first = await c.run(f"{TASKS}:echo", order, PLENTY, progress=told.append)
        second = await c.run(f"{TASKS}:echo", {}, PLENTY)
        assert first["order"] == order
        assert first["pid"] != second["pid"]
        assert set(first["open"]) <= {"0", "1", "2", "3", "4"}  # 4: the listing itself
        assert told[-1] == "second"
        assert list((tmp_path / "children").iterdir()) == []
    assert not (tmp_path / "children").exists()


@pytest.mark.parametrize(
    ("task", "order", "limits", "cause"),
    [
        ("crash", {}, PLENTY, "signal 11 (SIGSEGV)"),
        ("swallow", {"piece": 2**26, "pieces": 100}, PLENTY, "more than 1 GiB of memory"),
        ("swallow", {"piece": 2**14, "pieces": 10**6}, PLENTY, "more than 1 GiB of memory"),
        ("spin_in_c", {"pid": "/dev/null"}, Limits(2**30, 1.0, 60.0), "more than 1 s of processor time"),
        ("hang", {"pid": "/dev/null"}, Limits(2**30, 60.0, 0.5), "longer than 0.5 s"),
        ("break_down", {}, PLENTY, "unexpected error"),
        ("not_json", {}, PLENTY, "unexpected error"),
        ("nothing", {}, PLENTY, "unexpected error"),
    ],
)
async def test_a_child_that_dies_is_told_with_its_cause_and_the_next_one_works(tmp_path, task, order, limits, cause):
    async with children(tmp_path) as c:
        with pytest.raises(ChildEnded) as ended:
            await c.run(f"{TASKS}:{task}", order, limits)
        assert cause in str(ended.value)
        assert ended.value.status_code == 422
        assert (await c.run(f"{TASKS}:echo", {}, PLENTY))["order"] == {}


async def test_what_a_task_refuses_is_the_same_error_here(tmp_path):
    async with children(tmp_path) as c:
        with pytest.raises(FirmwareError, match="this cannot be"):
            await c.run(f"{TASKS}:refuse", {}, PLENTY)


@pytest.mark.parametrize(
    "text",
    ["", "[", "[]", "null", '{"other": 1}', '{"refused": 3}', '{"refused": {"kind": "x"}}', "[" * 100_000, "\x00"],
)
async def test_whatever_a_child_leaves_is_data_or_nothing(tmp_path, text):
    async with children(tmp_path) as c:
        with pytest.raises(ChildEnded, match="no result"):
            await c.run(f"{TASKS}:overwrite", {"folder": str(tmp_path / "children"), "text": text}, PLENTY)


async def test_a_refusal_of_no_known_kind_stays_an_input_error(tmp_path):
    async with children(tmp_path) as c:
        text = '{"refused": {"kind": "annotations", "text": "hm"}}'
        with pytest.raises(ValueError, match="hm"):
            await c.run(f"{TASKS}:overwrite", {"folder": str(tmp_path / "children"), "text": text}, PLENTY)


async def test_cancelling_kills_the_child_and_frees_its_place(tmp_path):
    async with children(tmp_path, most=1) as c:
        running = asyncio.create_task(c.run(f"{TASKS}:spin_in_c", {"pid": str(tmp_path / "pid")}, PLENTY))
        pid = await pid_in(tmp_path / "pid")
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert not alive(pid)
        assert (await c.run(f"{TASKS}:echo", {}, PLENTY))["order"] == {}


async def test_stopping_kills_what_runs(tmp_path):
    async with children(tmp_path) as c:
        running = asyncio.create_task(c.run(f"{TASKS}:spin_in_c", {"pid": str(tmp_path / "pid")}, PLENTY))
        pid = await pid_in(tmp_path / "pid")
        fork_server = c.fork_server_pid
        assert fork_server is not None
        await c.stop()
        await gone(pid)
        assert not alive(fork_server)
        with pytest.raises(ChildEnded):
            await running
        with pytest.raises(ChildEnded):
            await c.run(f"{TASKS}:echo", {}, PLENTY)


async def test_children_die_with_their_fork_server_and_a_new_one_serves(tmp_path):
    async with children(tmp_path) as c:
        running = asyncio.create_task(c.run(f"{TASKS}:spin_in_c", {"pid": str(tmp_path / "pid")}, PLENTY))
        pid = await pid_in(tmp_path / "pid")
        assert c.fork_server_pid is not None
        os.kill(c.fork_server_pid, signal.SIGKILL)
        with pytest.raises(ChildEnded, match="ended"):
            await running
        await gone(pid)
        assert (await c.run(f"{TASKS}:echo", {}, PLENTY))["order"] == {}


SERVICE = """
import asyncio, sys
from pathlib import Path
from mavcal.service.children import Children, Limits
async def main():
    c = Children(Path(sys.argv[1]) / "children", most=2, first=(), later=())
    orders = [{"pid": sys.argv[1] + "/pid1"}, {"pid": sys.argv[1] + "/pid2"}]
    limits = Limits(2**30, 300.0, 300.0)
    first = asyncio.create_task(c.run("tests.service.child_tasks:spin_in_c", orders[0], limits))
    second = asyncio.create_task(c.run("tests.service.child_tasks:hang", orders[1], limits))
    await asyncio.gather(first, second)
asyncio.run(main())
"""


async def test_no_child_survives_a_killed_service(tmp_path):
    service = await asyncio.create_subprocess_exec(sys.executable, "-c", SERVICE, str(tmp_path), cwd=ROOT)
    try:
        pids = [await pid_in(tmp_path / name) for name in ("pid1", "pid2")]
        assert all(alive(pid) for pid in pids)
    finally:
        service.kill()
        await service.wait()
    for pid in pids:
        await gone(pid)


async def test_only_so_many_at_a_time_and_so_many_waiting(tmp_path, monkeypatch):
    monkeypatch.setattr("mavcal.service.children.pool.MOST_WAITING", 3)
    async with children(tmp_path, most=1) as c:
        asked = [asyncio.create_task(c.run(f"{TASKS}:hang", {"pid": str(tmp_path / f"{i}")}, PLENTY)) for i in range(3)]
        await pid_in(tmp_path / "0")
        with pytest.raises(ChildrenBusy):
            await c.run(f"{TASKS}:echo", {}, PLENTY)
        assert not (tmp_path / "1").exists()
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)


async def test_starting_a_child_costs_a_fork_and_not_its_imports(tmp_path):
    async with children(tmp_path) as c:
        await c.run(f"{TASKS}:echo", {}, PLENTY)
        began = time.monotonic()
        for _ in range(10):
            await c.run(f"{TASKS}:echo", {}, PLENTY)
        assert (time.monotonic() - began) / 10 < 2.0  # the imports alone take seconds
