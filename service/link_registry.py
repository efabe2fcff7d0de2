"""The links that are open, remembered over restarts."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from mavcal.service.errors import EndpointError, EndpointRefused, LinkOpen, LinkUnknown
from mavcal.service.link.allowed import Allowed
from mavcal.service.link.endpoint import SIGNING, Endpoint, parse_endpoint
from mavcal.service.link.link import Link
from mavcal.service.link.types import OwnIdentity, SigningConfig
from mavcal.service.settings import MavlinkSettings
from mavcal.service.signing_keys import DEFAULT, UNSIGNED, SigningKeys
from mavcal.service.store.rows import LinkRow
from mavcal.service.store.sql import Store

LONGEST_URL = 1000
LONGEST_PLAIN = 64
"""Characters of an endpoint in the name of its link."""

Attach = Callable[[Link], None]


class LinkOwnership(Protocol):
    """Which links are ours to open."""

    async def claim(self, link_id: str) -> None:
        """Acquire the link. Raises LinkElsewhere."""

    async def release(self, link_id: str) -> None:
        """Release the link to other instances."""


class EveryLink:
    """One process owns every link."""

    async def claim(self, link_id: str) -> None:
        """Do nothing: every link is ours."""

    async def release(self, link_id: str) -> None:
        """Do nothing: there is no other instance."""


class LinkRegistry:
    """Opens and closes links; `attach` is told of each before it is opened, `detach` after it was closed."""

    def __init__(
        self,
        store: Store,
        tlog_dir: Path,
        settings: MavlinkSettings,
        *,
        keys: SigningKeys,
        allowed: Allowed,
        attach: Attach,
        detach: Attach,
        ownership: LinkOwnership | None = None,
    ) -> None:
        self._store = store
        self._tlog_dir = tlog_dir
        self._settings = settings
        self._keys = keys
        self._allowed = allowed
        self._attach = attach
        self._detach = detach
        self._ownership = ownership or EveryLink()
        self._links: dict[str, Link] = {}

    def all(self) -> tuple[Link, ...]:
        """Every open link, in the order of opening."""
        return tuple(self._links.values())

    def get(self, link_id: str) -> Link:
        """The link of that id.

        Raises
        ------
        LinkUnknown
            If there is none.
        """
        link = self._links.get(link_id)
        if link is None:
            raise LinkUnknown(f"there is no link {link_id}; GET /api/v1/links lists them")
        return link

    async def open(self, url: str, *, remember: bool = True, trusted: bool = False) -> Link:
        """Open a link; one that is open already is returned as it is. `trusted`: named by who runs the service.

        Raises
        ------
        EndpointRefused
            If it is not trusted, and not allowed.
        LinkElsewhere
            If another instance of the service has it open.
        EndpointError, PortBusy
            If this endpoint can never work as it is.
        SigningKeyError
            If its key is not known or cannot be read: it is not opened unsigned instead.
        LinkOpen
            If it is open with another key.
        """
        endpoint = _parsed(url)
        if not trusted:
            endpoint = self._allowed.endpoint(endpoint)
            if endpoint.option(SIGNING) == UNSIGNED:
                raise EndpointRefused(f"{SIGNING}={UNSIGNED} is for the settings and the command line alone")
        link_id = _slug(str(endpoint.place))
        signing = self.signing(link_id, endpoint.option(SIGNING))
        if link_id not in self._links:
            await self._ownership.claim(link_id)
        if link_id in self._links:  # also if another call was faster meanwhile
            return self._as_open(self._links[link_id], signing)
        link = Link(
            link_id,
            endpoint,
            tlog_dir=self._tlog_dir,
            ids=OwnIdentity(system=self._settings.system, component=self._settings.component),
            signing=signing,
            store_timestamp=lambda timestamp: self._keep_timestamp(link, timestamp),
        )
        self._links[link_id] = link
        self._attach(link)
        try:
            await link.open()
        except BaseException:
            del self._links[link_id]
            self._detach(link)
            await self._ownership.release(link_id)
            raise
        if remember:
            await self._remember(link_id, endpoint)
        return link

    async def _remember(self, link_id: str, endpoint: Endpoint) -> None:
        row = LinkRow(link_id, str(endpoint), time.time())
        await self._store.do(lambda: self._store.save_link(row))

    @staticmethod
    def _as_open(link: Link, signing: SigningConfig | None) -> Link:
        asked = None if signing is None else signing.name
        if link.signing_key != asked:
            raise LinkOpen(
                f"link {link.id} is open and {_signed(link.signing_key)}, not {_signed(asked)}: close it first"
            )
        return link

    async def signed(self, link: Link, key: str) -> None:
        """Remember that a link is signed with that key now, for the next start and the next look."""
        link.endpoint = link.endpoint.signed_with(key)
        await self._remember(link.id, link.endpoint)

    async def close(self, link_id: str) -> None:
        """Close a link for good. Raises LinkUnknown if there is none of that id."""
        link = self.get(link_id)
        await self._store.do(lambda: self._store.delete_link(link_id))
        await self._end(link)
        await self._ownership.release(link_id)

    async def leave(self, link_id: str) -> None:
        """Close a link that is another instance's now; one that is not open is no error."""
        if link_id in self._links:
            await self._end(self._links[link_id])

    async def close_all(self) -> None:
        """Close every link; they are opened again at the next start."""
        for link in self.all():
            await self._end(link)

    async def _end(self, link: Link) -> None:
        del self._links[link.id]
        await link.close()
        self._detach(link)

    def _keep_timestamp(self, link: Link, timestamp: int) -> None:
        stream = _stream(link.id, link.signing_key or DEFAULT)
        self._store.soon(lambda: self._store.save_signing_timestamp(stream, timestamp))

    def signing(self, link_id: str, name: str | None) -> SigningConfig | None:
        """How a link is signed that names this key; `name` None: it names none. See :meth:`SigningKeys.named`."""
        found = self._keys.named(name)
        if found is None:
            return None
        name, key = found
        return SigningConfig(key, timestamp=self._store.signing_timestamp(_stream(link_id, name)), name=name)


def _stream(link_id: str, key: str) -> str:
    """Name under which the newest time stamp of a link is kept: one for each key."""
    return link_id if key == DEFAULT else f"{link_id}?{SIGNING}={key}"


def _signed(key: str | None) -> str:
    return "not signed" if key is None else f"signed with the key {key!r}"


def link_id_of(url: str) -> str:
    """The id of the link with that endpoint. Raises EndpointError."""
    return _slug(str(_parsed(url).place))


def _parsed(url: str) -> Endpoint:
    if len(url) > LONGEST_URL or not url.isprintable():
        raise EndpointError(f"an endpoint has at most {LONGEST_URL} printable characters")
    return parse_endpoint(url)


_PLAIN = re.compile(r"file:[A-Za-z0-9.-]+|(?!file:)[a-z]+:[A-Za-z0-9.-]+:\d+|(?!file:)[a-z]+:[A-Za-z0-9.]+")
"""Endpoints in which a dash can only have been a colon."""


def _slug(endpoint: str) -> str:
    """A name for files and addresses: ``udpin-0.0.0.0-14550``; no two endpoints share one."""
    plain = re.sub(r"[^A-Za-z0-9.]", "-", endpoint)
    if len(plain) <= LONGEST_PLAIN and _PLAIN.fullmatch(endpoint):
        return plain
    digest = hashlib.sha256(endpoint.encode()).hexdigest()[:12]
    return f"{re.sub('-+', '-', plain)[:LONGEST_PLAIN].strip('-.')}-{digest}"
