"""Limits how often one peer may try an API key."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from ipaddress import IPv6Address, ip_address

AT_ONCE = 10
"""Failures that a peer may have in quick succession."""
EVERY_S = 6.0
"""Afterwards one more so often."""
MOST_PEERS = 1024


class Throttle:
    """Counts failed logins by peer; memory is bounded, the peer that failed longest ago is forgotten first."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._paid_until: OrderedDict[str, float] = OrderedDict()
        """When the last failure of a peer will be forgiven: each failure adds EVERY_S."""

    def wait_s(self, peer: str) -> float:
        """Seconds that this peer has to wait before its next try; 0: none."""
        paid = self._paid_until.get(_group(peer), 0.0) - self._clock()
        return max(0.0, paid - (AT_ONCE - 1) * EVERY_S)

    def failed(self, peer: str) -> None:
        """Note a failure."""
        now, group = self._clock(), _group(peer)
        self._paid_until[group] = max(self._paid_until.pop(group, now), now) + EVERY_S
        if len(self._paid_until) > MOST_PEERS:
            self._paid_until.popitem(last=False)

    def __len__(self) -> int:
        return len(self._paid_until)


def _group(peer: str) -> str:
    """The address of the peer, or its /64 network: one IPv6 host has all addresses of that."""
    try:
        address = ip_address(peer)
    except ValueError:
        return peer[:64]
    return str(IPv6Address(int(address) >> 64 << 64)) if isinstance(address, IPv6Address) else peer
