"""Lines typed at the terminal while a job runs."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any

Answer = Callable[[str], Coroutine[Any, Any, None]]


class Keyboard:
    """Passes every typed line to this command's own question if there is one, else to the job's prompt."""

    def __init__(self, *, there: bool) -> None:
        self.there = there
        """Whether anybody can be asked: False for scripts, whose stdin is no terminal."""
        self._question: asyncio.Future[str] | None = None

    async def asked(self) -> str:
        """The next line; empty if nobody will type one any more."""
        if not self.there:
            return ""
        self._question = asyncio.get_running_loop().create_future()
        try:
            return await self._question
        finally:
            self._question = None

    async def listen(self, answer: Answer) -> None:
        """Read lines until the terminal is closed."""
        reader = asyncio.StreamReader()
        loop = asyncio.get_running_loop()
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            await self._typed(line.decode(errors="replace").strip(), answer)
        self.there = False
        self._settle("")

    async def _typed(self, line: str, answer: Answer) -> None:
        if self._question is not None:
            self._settle(line)
        elif line:  # a bare Enter is no answer to a job
            await answer(line)

    def _settle(self, line: str) -> None:
        if self._question is not None and not self._question.done():
            self._question.set_result(line)


@asynccontextmanager
async def keyboard(answer: Answer) -> AsyncIterator[Keyboard]:
    """The terminal's keyboard for as long as a job runs; `answer` takes what is typed to the job."""
    typed = Keyboard(there=sys.stdin.isatty())
    if not typed.there:
        yield typed
        return
    listening = asyncio.create_task(typed.listen(answer))
    try:
        yield typed
    finally:
        listening.cancel()
        with suppress(asyncio.CancelledError):
            await listening
