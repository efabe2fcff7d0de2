"""What a list of allowed endpoints is made of: words, networks, hosts and devices."""

from __future__ import annotations

import ipaddress
import re

IpNetwork = ipaddress.IPv4Network | ipaddress.IPv6Network

SERIAL, SIM, LOOPBACK, PRIVATE, ANY = "serial", "sim", "loopback", "private", "any"
DEFAULT = (SERIAL, SIM, LOOPBACK, PRIVATE)
NETWORKS = {
    LOOPBACK: ("127.0.0.0/8", "::1/128"),
    PRIVATE: ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "fc00::/7", "fe80::/10"),
    ANY: ("0.0.0.0/0", "::/0"),
}
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


def checked_entry(entry: str) -> str:
    """`entry` if it may stand in the list of what is allowed. Raises ValueError."""
    if entry in {SERIAL, SIM, *NETWORKS} or entry.startswith("/dev/") or network(entry) is not None:
        return entry
    if _HOST.fullmatch(entry):
        return entry.lower()
    raise ValueError(
        f"{entry!r} is none of {', '.join((*DEFAULT, ANY))}, no network as 10.1.0.0/16, no host, no /dev/…"
    )


def network(text: str) -> IpNetwork | None:
    """`text` as a network; None if it is none."""
    try:
        return ipaddress.ip_network(text, strict=False)
    except ValueError:
        return None
