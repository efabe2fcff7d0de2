"""A worker: takes computations out of the queue and has its own child processes do them, within their limits.

It proves that it is alive by heartbeats of the queue. Without heartbeats, its computations are given to another worker,
at most three times, since a computation may itself end workers.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from mavcal.calib.errors import CalibError
from mavcal.service.children import Children, Limits
from mavcal.service.errors import ServiceError, StoreError
from mavcal.service.settings import Settings
from mavcal.service.workers.orders import Computation, Json, Orders
from mavcal.service.workers.queue import QUEUE, TASK, app_of, moved

log = structlog.get_logger(__name__)
MOST_STARTS = 3
WATCH_S = 1.0
"""Period of the check whether the computation is still wanted, s."""
SWEEP_S = 3600.0
"""Time after which unwanted orders are deleted, s."""
BEATS_A_LEASE = 4


class Worker:
    """Computes until its task is cancelled.

    Parameters
    ----------
    settings
        Name the database, the folder of uploads, and how many computations run at a time.
    scratch
        A folder of its own.
    """

    def __init__(self, settings: Settings, scratch: Path) -> None:
        assert settings.database_url is not None
        self._url = settings.database_url.get_secret_value()
        self._settings = settings
        self.name = f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(4)}"
        self._orders = Orders(self._url, settings.fleet.lease_s)
        self._children = Children(scratch, most=settings.limits.file_processes)
        self._app = app_of(self._url)
        self._app.task(name=TASK, queue=QUEUE)(self.compute)

    async def run(self) -> None:
        """Work until this is cancelled, or the process gets SIGINT or SIGTERM."""
        lease_s = self._settings.fleet.lease_s
        async with AsyncExitStack() as started:
            started.callback(self._orders.close)
            started.push_async_callback(self._children.stop)
            await started.enter_async_context(self._app.open_async())
            await started.enter_async_context(_meanwhile(self._rescue()))
            log.info("worker ready", worker=self.name, at_a_time=self._settings.limits.file_processes)
            await self._app.run_worker_async(
                queues=[QUEUE],
                name=self.name,
                concurrency=self._settings.limits.file_processes,
                fetch_job_polling_interval=2.0,
                abort_job_polling_interval=1.0,
                update_heartbeat_interval=lease_s / BEATS_A_LEASE,
                stalled_worker_timeout=lease_s,
                shutdown_graceful_timeout=0.0,
                delete_jobs="always",
            )

    async def compute(self, computation: str) -> None:
        """Run one task of the queue."""
        order = await asyncio.to_thread(self._orders.take, computation, self.name)
        if order is None:
            return
        if order.starts > MOST_STARTS:
            result: Json | None = {"ended": f"the worker that computed it ended, {MOST_STARTS} times"}
        else:
            result = await self._result(order)
        if result is not None:
            await asyncio.to_thread(self._orders.finish, order.id, self.name, result)

    async def _result(self, order: Computation) -> Json | None:
        """The result of a computation; None: nobody waits for it any more."""
        loop = asyncio.get_running_loop()

        def report(text: str) -> None:
            loop.run_in_executor(None, partial(self._orders.report_progress, order.id, self.name, text))

        body = moved(order.body["order"], None, self._settings.uploads)
        running = asyncio.create_task(
            self._children.run(order.task, body, Limits(**order.body["limits"]), progress=report)
        )
        try:
            while not running.done():
                await asyncio.wait({running}, timeout=WATCH_S)
                if not running.done() and not await asyncio.to_thread(self._orders.wanted, order.id, self.name):
                    return None
            return {"done": running.result()}
        except CalibError as error:
            return {"refused": {"kind": type(error).__name__, "text": str(error)}}
        except StoreError:
            raise
        except ServiceError as error:
            return {"ended": str(error)}
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    async def _rescue(self) -> None:
        """Give computations of workers that died back to the queue, and forget what nobody waits for."""
        lease_s = self._settings.fleet.lease_s
        while True:
            try:
                manager = self._app.job_manager
                for job in await manager.get_stalled_jobs(queue=QUEUE, seconds_since_heartbeat=lease_s):
                    log.warning("computation of a dead worker taken back", job=job.id)
                    await manager.retry_job(job)
                await asyncio.to_thread(self._orders.sweep, SWEEP_S)
            except Exception as error:  # noqa: BLE001 - the database may be away; tried again
                log.warning("no computation was rescued this time", reason=str(error))
            await asyncio.sleep(lease_s / BEATS_A_LEASE)


@asynccontextmanager
async def _meanwhile(work: Any) -> AsyncIterator[None]:
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
