"""The routing table of a link: the address of every sender, and suspicious changes of it."""

from __future__ import annotations

from mavcal.service.link.types import Address, LinkEvent, LinkEventKind, OwnIdentity

INTERLEAVE_S = 5.0
"""Time within which alternating addresses are two vehicles, not one that moved."""
RECENT_S = 30.0
"""Broadcasts go to the addresses heard within this time."""
_MAX_ADDRESSES = 64


class _Sender:
    __slots__ = ("address", "left", "warned_at")

    def __init__(self, address: Address) -> None:
        self.address = address
        self.left: dict[Address, float] = {}  # when an earlier address was last heard
        self.warned_at = -1e9


class PeerTable:
    """Remembers the address each (system, component) was last heard from."""

    def __init__(self, own: OwnIdentity) -> None:
        self._own = (own.system, own.component)
        self._own_warned_at = -1e9
        self._senders: dict[tuple[int, int], _Sender] = {}
        self._heard: dict[Address, float] = {}

    def see(self, system: int, component: int, address: Address, now: float) -> LinkEvent | None:
        """Note a sender; returns an event if one is due, at most one every few seconds for each sender."""
        self._heard.pop(address, None)
        self._heard[address] = now
        if len(self._heard) > _MAX_ADDRESSES:
            del self._heard[next(iter(self._heard))]  # the one not heard for longest
        key = (system, component)
        sender = self._senders.get(key)
        if sender is None:
            self._senders[key] = _Sender(address)
            return None
        if sender.address == address:
            return None
        previous, sender.address = sender.address, address
        interleaved = now - sender.left.get(address, -1e9) < INTERLEAVE_S
        sender.left[previous] = now
        if len(sender.left) > _MAX_ADDRESSES:
            sender.left.pop(min(sender.left, key=sender.left.__getitem__))
        if now - sender.warned_at < INTERLEAVE_S:
            return None
        if interleaved:
            sender.warned_at = now
        return _moved(key, previous, address, interleaved=interleaved)

    def own_ids(self, address: Address, now: float) -> LinkEvent | None:
        """Report that a frame that we did not send carries our own ids."""
        if now - self._own_warned_at < INTERLEAVE_S:
            return None
        self._own_warned_at = now
        return LinkEvent(
            LinkEventKind.OWN_IDS_HEARD,
            f"Somebody at {_named(address)} speaks with our ids {self._own[0]}/{self._own[1]}. "
            "Two programs must not share them: give one of them another system id.",
            *self._own,
            addresses=(address,),
        )

    def address(self, system: int, component: int) -> Address | None:
        """Address of this component, or None if its system was never heard.

        A component never heard shares the way of its system.
        """
        sender = self._senders.get((system, component))
        if sender is not None:
            return sender.address
        of_system = [s.address for (other, _), s in list(self._senders.items()) if other == system]
        return of_system[-1] if of_system else None

    def recent(self, now: float) -> tuple[Address, ...]:
        """Addresses heard lately."""
        return tuple(address for address, at in list(self._heard.items()) if now - at < RECENT_S)

    def snapshot(self) -> dict[tuple[int, int], Address]:
        """The whole table."""
        return {key: sender.address for key, sender in list(self._senders.items())}


def _named(address: Address) -> str:
    return f"{address[0]}:{address[1]}" if address[1] else address[0]


def _moved(key: tuple[int, int], old: Address, new: Address, *, interleaved: bool) -> LinkEvent:
    system, component = key
    if interleaved:
        kind = LinkEventKind.DUPLICATE_SYSTEM
        text = (
            f"Two senders use system id {system}: {_named(old)} and {_named(new)} take turns. "
            "Give every vehicle its own system id; nothing is written until then."
        )
    else:
        kind = LinkEventKind.PEER_CHANGED
        text = f"Vehicle {system}/{component} now speaks from {_named(new)}; before it was {_named(old)}."
    return LinkEvent(kind, text, system, component, addresses=(old, new))
