"""The instance's side of workers: orders in, results out, as from child processes of its own."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import structlog

from mavcal.service.children.limits import Limits
from mavcal.service.children.pool import ProgressCallback, refusal
from mavcal.service.errors import ChildEnded, StoreError
from mavcal.service.workers.orders import Json, Orders
from mavcal.service.workers.queue import QUEUE, TASK, app_of, lock_of, moved

log = structlog.get_logger(__name__)
LOOK_S = 0.3
"""Period of the look for a result, s."""


class RemoteChildren:
    """Has tasks of :mod:`service.children.tasks` run by workers; see :class:`service.children.pool.Children`.

    Parameters
    ----------
    url
        The database.
    uploads
        The folder that workers share.
    wanted_s
        Workers stop computing for an instance that was silent for so long.
    """

    most = 16
    """Items of a campaign at a time. The number of workers is unknown; excess items wait in the queue."""

    def __init__(self, url: str, uploads: Path, wanted_s: float) -> None:
        self._orders = Orders(url, wanted_s)
        self._app = app_of(url)
        self._uploads = uploads

    async def start(self) -> None:
        """Connect to the queue."""
        await self._app.open_async()

    async def stop(self) -> None:
        """Disconnect; workers stop our computations once they are no longer wanted."""
        await self._app.close_async()
        self._orders.close()

    async def run(
        self, task: str, order: Mapping[str, Any], limits: Limits, *, progress: ProgressCallback | None = None
    ) -> Json:
        """The result of one task; when this is cancelled the computation is ended. Errors are those of Children."""
        order_id = secrets.token_hex(8)
        body = {"order": moved(dict(order), self._uploads, None), "limits": asdict(limits)}
        await asyncio.to_thread(self._orders.put, order_id, task, body)
        queued = None
        try:
            lock = lock_of(order_id, order.get("vehicle"))
            configured = self._app.configure_task(TASK, queue=QUEUE, lock=lock)
            queued = await configured.defer_async(computation=order_id)
            return _done(await self._ended(order_id, progress))
        finally:
            await asyncio.shield(self._forget(order_id, queued))

    async def _ended(self, order_id: str, progress: ProgressCallback | None) -> Json:
        last = None
        while True:
            try:
                now = await asyncio.to_thread(self._orders.look, order_id)
            except StoreError as error:  # the database is away: the order is there when it comes back
                log.warning("a computation was not looked for", reason=str(error))
            else:
                if now.said is not None and now.said != last and progress is not None:
                    progress(now.said)
                last = now.said
                if now.result is not None:
                    return now.result
            await asyncio.sleep(LOOK_S)

    async def _forget(self, order_id: str, queued: int | None) -> None:
        with suppress(StoreError):  # it is then forgotten by a worker, in time
            await asyncio.to_thread(self._orders.forget, order_id)
        if queued is not None:
            try:
                await self._app.job_manager.cancel_job_by_id_async(queued, abort=True)
            except Exception as error:  # noqa: BLE001 - nobody waits for it: a worker finds no order and ends
                log.warning("a computation was not cancelled in the queue", reason=str(error))


def _done(result: Json) -> Json:
    if "refused" in result:
        raise refusal(str(result["refused"]["kind"]), str(result["refused"]["text"]))
    if "done" not in result:
        raise ChildEnded(str(result.get("ended") or result.get("lost")))
    done: Json = result["done"]
    return done
