"""Endpoints that a client on the network may open: by kind, by address, by folder.

The operator who starts the service names endpoints freely; HTTP clients are bound by the settings. A refusal says the
same whether a file is missing or forbidden.
"""

from __future__ import annotations

import ipaddress
import re
import stat
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mavcal.service.errors import EndpointRefused
from mavcal.service.link.endpoint import Endpoint, EndpointKind
from mavcal.service.settings import ANY, NETWORKS, PRIVATE, SERIAL, SIM
from mavcal.service.settings import network as as_network

IpAddress = ipaddress.IPv4Address | ipaddress.IPv6Address

DEVICE = re.compile(r"/dev/(tty[A-Za-z]+\d+|(tty|cu)\.[\w.-]+|rfcomm\d+|serial/by-(id|path)/[\w.:+-]+)|COM\d+")
"""Names of serial devices."""
_FILE_OPTIONS = ("params", "config")
"""Options of a simulated vehicle that may name a file."""


class Allowed:
    """What may be opened: the entries of :func:`service.settings.checked_entry`, and recordings inside `folders`."""

    def __init__(self, entries: Sequence[str], folders: Sequence[Path]) -> None:
        self._entries = frozenset(entries)
        texts = [text for entry in entries for text in NETWORKS.get(entry, (entry,))]
        self._networks = [network for text in texts if (network := as_network(text)) is not None]
        self._folders = tuple(folders)

    def endpoint(self, endpoint: Endpoint) -> Endpoint:
        """The endpoint that may be opened, with symbolic links in file paths resolved.

        Raises
        ------
        EndpointRefused
            If it may not.
        """
        kind = endpoint.kind
        if kind is EndpointKind.FILE:
            return replace(endpoint, path=str(self._file(endpoint.path)))
        if kind is EndpointKind.SIM:
            self._require(SIM in self._entries, "a simulated vehicle", SIM)
            return replace(endpoint, options=tuple((n, self._option(n, value)) for n, value in endpoint.options))
        if kind is EndpointKind.SERIAL:
            known = SERIAL in self._entries and DEVICE.fullmatch(endpoint.path)
            self._require(bool(known) or endpoint.path in self._entries, endpoint.path, endpoint.path)
        else:
            self._require(self._host(endpoint), endpoint.host, endpoint.host)
        return endpoint

    def _host(self, endpoint: Endpoint) -> bool:
        name = endpoint.host.lower()
        if name in self._entries or ANY in self._entries:
            return True
        address = _address("127.0.0.1" if name == "localhost" else name)
        if address is None:
            return False
        listening = endpoint.kind in {EndpointKind.UDPIN, EndpointKind.TCPIN}
        if listening and address.is_unspecified:  # every address of this machine
            return PRIVATE in self._entries
        return any(address in network for network in self._networks)

    def _option(self, name: str, value: str) -> str:
        inline = name not in _FILE_OPTIONS or (name == "config" and value.lstrip().startswith("{"))
        return value if inline else str(self._file(value))

    def _file(self, path: str) -> Path:
        """The real path of a regular file inside the folders."""
        try:
            real = Path(path).resolve(strict=True)
            inside = any(real.is_relative_to(folder.resolve()) for folder in self._folders)
            if inside and stat.S_ISREG(real.stat().st_mode):
                return real
        except (OSError, ValueError, RuntimeError):
            pass
        raise EndpointRefused(
            "there is no such recording in the folders that may be replayed from: `links.folders` in the settings "
            "names them, beside the telemetry logs of this service"
        )

    def _require(self, holds: bool, what: str, entry: str) -> None:
        if not holds:
            raise EndpointRefused(
                f"{what} is not among the endpoints that may be opened: add {entry!r} to links.allowed"
            )


def _address(text: str) -> IpAddress | None:
    """The parsed address; an IPv4-mapped IPv6 address as plain IPv4."""
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        return None
    mapped = getattr(address, "ipv4_mapped", None)
    return address if mapped is None else mapped
