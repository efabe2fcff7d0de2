"""Subscribers to the frames of one vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import LinkDown
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch

_MARK_S = 5.0

FramesCallback = Callable[[Sequence[Frame], Batch], None]


@dataclass(eq=False)
class _Subscriber:
    message_ids: frozenset[int]
    callback: FramesCallback
    over: Link | None
    """Only frames of this link; None: of whichever is in use."""
    asked: dict[str, Callable[[], None]] = field(default_factory=dict)

    def ask(self, link: Link) -> None:
        self.asked[link.id] = link.subscribe(lambda _batch: None, self.message_ids)


class Subscribers:
    """Passes each subscriber its frames, and has every link deliver the messages that are needed."""

    def __init__(self) -> None:
        self._all: dict[object, _Subscriber] = {}

    def __bool__(self) -> bool:
        return bool(self._all)

    def add(
        self, message_ids: frozenset[int], callback: FramesCallback, links: Iterable[Link], over: Link | None
    ) -> Callable[[], None]:
        """Add a subscriber until the returned function is called; `over`: for frames of this link alone."""
        key, subscriber = object(), _Subscriber(message_ids, callback, over)
        for link in links if over is None else (over,):
            subscriber.ask(link)
        self._all[key] = subscriber

        def remove() -> None:
            if self._all.pop(key, None) is not None:
                _forget(subscriber)

        return remove

    def join(self, link: Link) -> None:
        """Receive frames over this link too."""
        for subscriber in self._all.values():
            if subscriber.over is None:
                subscriber.ask(link)

    def leave(self, link: Link) -> None:
        """Receive nothing over this link any more."""
        for subscriber in self._all.values():
            subscriber.asked.pop(link.id, _nothing)()

    def hand_on(self, frames: Sequence[Frame], batch: Batch, link: Link, *, used: bool) -> None:
        """Pass on the frames of a link; `used`: the link is the one in use."""
        loop = asyncio.get_running_loop()
        for key, subscriber in list(self._all.items()):
            wanted = used if subscriber.over is None else subscriber.over is link
            chosen = [frame for frame in frames if frame.message_id in subscriber.message_ids] if wanted else []
            if chosen:
                loop.call_soon(self._hand, key, chosen, batch)

    def _hand(self, key: object, frames: Sequence[Frame], batch: Batch) -> None:
        subscriber = self._all.get(key)
        if subscriber is not None:
            subscriber.callback(frames, batch)

    def close(self) -> None:
        """End every subscription."""
        for subscriber in self._all.values():
            _forget(subscriber)
        self._all.clear()


async def begun_at(
    link: Link, message_ids: frozenset[int], begin: Callable[[], Callable[[], None]]
) -> tuple[int, Callable[[], None]]:
    """Call `begin` between two batches; the byte of the link's recording where the second begins, and what it gave.

    Raises
    ------
    LinkDown
        If the link is not connected.
    """
    begun: asyncio.Future[tuple[int, Callable[[], None]]] = asyncio.get_running_loop().create_future()

    def reached(position: int) -> None:
        if not begun.done():
            begun.set_result((position, begin()))

    hold = link.subscribe(lambda _batch: None, message_ids)
    try:
        link.mark(reached)
        await asyncio.wait({begun}, timeout=_MARK_S)
        if not begun.done():
            raise LinkDown(f"Link {link.id} ({link.endpoint}) does not read: {link.reason}")
    except BaseException:
        if begun.done():
            begun.result()[1]()
        begun.cancel()
        raise
    finally:
        hold()
    return begun.result()


def _forget(subscriber: _Subscriber) -> None:
    for forget in subscriber.asked.values():
        forget()


def _nothing() -> None:
    """Do nothing: this link was not asked for frames."""
