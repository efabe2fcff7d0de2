"""Connects live commands to a service: a running one, or the application in this process.

Ctrl-C and SIGTERM end a command in an orderly way: its task is cancelled, and says what it leaves behind.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from mavcal.service.commands.remote import address, key_in, noes
from mavcal.service.loading import loading

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.service.commands.asking import RaisingClient
    from mavcal.service.commands.whom import Whom
    from mavcal.service.hosting import Hosted


T = TypeVar("T")

COMMAND = "command line"
OPERATOR = "operator"
"""Name of the operator in the record of a write; a remote service records the name of the key."""
ANSWER_S = 600.0
"""Longest wait for an answer, s: a preflight that first calibrates takes minutes."""
CLEANUP_S = 30.0
"""How long the vehicle may take to confirm its old message rates, and to be looked at after a write."""
HURRY_S = 5.0
"""The same limit for a run that was told to stop."""
_LOOK_S = 0.1


@contextmanager
def stoppable() -> Iterator[list[int]]:
    """Cancel the current task on SIGINT and SIGTERM; the list holds the signals that came."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    caught: list[int] = []

    def stop(number: int) -> None:
        caught.append(number)
        if task is not None:
            task.cancel()

    numbers = (signal.SIGINT, signal.SIGTERM)
    with suppress(NotImplementedError):  # not on every system: there the interpreter's own handling stays
        for number in numbers:
            loop.add_signal_handler(number, stop, number)
    try:
        yield caught
    finally:
        with suppress(NotImplementedError):
            for number in numbers:
                loop.remove_signal_handler(number)


@dataclass(frozen=True)
class Door:
    """A service and the client to it."""

    client: AsyncClient
    own: Hosted | None = None
    """The application in this process; None: the service runs elsewhere."""

    @property
    def shared(self) -> bool:
        """Whether others use the service too, and it goes on when the command has ended."""
        return self.own is None

    async def open(self, endpoint: str) -> str:
        """The id of a link of this command. Raises EndpointError, PortBusy."""
        assert self.own is not None
        return await self.own.open(endpoint)

    async def wait_for_cleanup(self, seconds: float = CLEANUP_S, *, written: str | None = None) -> None:
        """Wait until the old message rates are back, for a limited time; the next run returns what is left.

        `written` is a job after whose write the vehicle is checked. A service elsewhere restores the rates itself, and
        is awaited until that check is done.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                if self.own is not None:
                    await self.own.wait_for_cleanup()
                    return
                while written is not None and _to_be_looked_at(await self.client.get_job(written)):  # noqa: ASYNC110
                    await asyncio.sleep(_LOOK_S)


def _to_be_looked_at(job: JobModel) -> bool:
    from mavcal.client.enums import JobState

    return job.state == JobState.SUCCEEDED and job.last_write is not None and job.readiness is None


def through_door(whom: Whom, act: Callable[[Door], Awaitable[T]], actor: str = COMMAND) -> T | int:
    """Run `act` on the open door: its result, or the exit code if a signal stopped the run."""

    async def run() -> T | int:
        with stoppable() as caught:
            try:
                async with door(whom, actor) as at:
                    return await act(at)
            except asyncio.CancelledError:
                if not caught:
                    raise
                return 128 + caught[0]

    return asyncio.run(run())


@asynccontextmanager
async def door(whom: Whom, actor: str = COMMAND) -> AsyncIterator[Door]:
    """The service of a ``--url``, which nothing here stops; or the application in this process, which leaves nothing.

    Raises
    ------
    AnsweredNo
        If the service does not answer, or not as it should.
    DataDirLocked
        If another process owns the data directory.
    """
    if whom.url is not None:
        url, key = address(whom.url), key_in(whom.key_file)
        with noes():
            async with _loaded()(url, key=key, timeout_s=ANSWER_S) as asking:
                yield Door(asking)
        return
    with loading():
        from mavcal.service.hosting import hosted
        from mavcal.service.logs import configure_logging

    configure_logging(as_json=whom.settings.log_json)
    async with hosted(whom.settings, actor, whom.urls) as own:
        client = await asyncio.to_thread(_loaded)
        async with client(own.url, key=own.key, timeout_s=ANSWER_S) as asking:
            yield Door(asking, own)


def _loaded() -> type[RaisingClient]:
    with loading():
        from mavcal.service.commands.asking import RaisingClient

        return RaisingClient
