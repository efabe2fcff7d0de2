"""Stores and removes signing keys, gives them to vehicles, and leaves an entry in the audit trail."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import Any

from mavcal.service.errors import Forbidden, LinkOpen, SigningKeyError, SigningNotConfirmed
from mavcal.service.link.link import OFFER_S, OFFERS, Link
from mavcal.service.link_registry import LinkRegistry
from mavcal.service.signing_keys import KnownKey, SigningKeys
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.registry import VehicleRegistry


class SigningAdmin:
    """Keys of a running service. Nothing here gives a key back."""

    def __init__(
        self, keys: SigningKeys, links: LinkRegistry, vehicles: VehicleRegistry, store: Store, *, read_only: bool
    ) -> None:
        self._keys = keys
        self._links = links
        self._vehicles = vehicles
        self._store = store
        self._read_only = read_only

    async def all(self) -> tuple[KnownKey, ...]:
        """Name and fingerprint of every key. Raises SigningKeyError if the file cannot be used."""
        return await asyncio.to_thread(self._keys.all)

    async def add(self, name: str, key: str | None, actor: str) -> KnownKey:
        """Store a key; None: make a new one. Raises SigningKeyError if that fails."""
        known, _ = await asyncio.to_thread(self._keys.add, name, key)
        await audit(self._store, actor, "signing key added", known)
        return known

    async def remove(self, name: str, actor: str) -> None:
        """Forget a key.

        Raises
        ------
        SigningKeyUnknown
            If there is none of that name.
        SigningKeyError
            If the settings hold it, or an open link is signed with it.
        """
        users = [link.id for link in self._links.all() if link.signing_key == name]
        if users:
            raise SigningKeyError(f"the signing key {name!r} is in use by {', '.join(users)}: close that link first")
        gone = await asyncio.to_thread(self._keys.remove, name)
        await audit(self._store, actor, "signing key removed", gone)

    async def set_up(self, link_id: str, key: str, actor: str) -> Link:
        """Give the one vehicle of a link this key, and sign once the vehicle signs with it.

        The key goes over the link as it is: do this on a link that nobody listens to, such as USB.

        Raises
        ------
        LinkUnknown, SigningKeyUnknown
            If there is no such link or key.
        LinkOpen
            If the link is signed already.
        SigningKeyError
            If there is not exactly one vehicle on the link.
        VehicleArmed, VehicleBusy, VehicleSilent, VehicleConflict
            If the vehicle may not be written to.
        SigningNotConfirmed
            If the vehicle does not sign with the key: the link stays as it was.
        """
        if self._read_only:
            raise Forbidden("this service runs with --read-only and never writes to a vehicle, a signing key included")
        link = self._links.get(link_id)
        if link.signing_key is not None:
            raise LinkOpen(f"link {link.id} is signed with the key {link.signing_key!r} already")
        vehicles = [vehicle for vehicle in self._vehicles.all() if link in vehicle.links]
        if len(vehicles) != 1:
            raise SigningKeyError(
                f"{len(vehicles)} vehicles are heard on link {link.id}: one is needed, because a vehicle without the "
                "key is not believed afterwards"
            )
        (vehicle,) = vehicles
        vehicle.require_writable(name="The signing key")
        signing = self._links.signing(link.id, key)
        if signing is None:
            raise SigningKeyError(f"{key!r} is no signing key")
        await self._note(actor, "signing set up", link.id, {"key": key, "vehicle": vehicle.id})
        if not await link.offer_key(signing, (vehicle.system, vehicle.component)):
            raise SigningNotConfirmed(
                f"vehicle {vehicle.id} was given the key {key!r} {OFFERS} times and signed nothing with it within "
                f"{OFFERS * OFFER_S:g} s: the link stays unsigned. Does this firmware sign? If it falls silent now, it "
                f"has taken the key: close the link and open it with ?signing={key}"
            )
        await self._links.signed(link, key)
        await self._note(actor, "signing confirmed", link.id, {"key": key, "vehicle": vehicle.id})
        return link

    async def _note(self, actor: str, action: str, subject: str, detail: dict[str, Any]) -> None:
        await self._store.do(partial(self._store.add_audit, time.time(), actor, action, subject, detail))


async def audit(store: Store, actor: str, action: str, key: KnownKey) -> None:
    """Put what was done with a key into the audit trail, by its name and fingerprint."""
    detail = {"fingerprint": key.fingerprint}
    await store.do(partial(store.add_audit, time.time(), actor, action, key.name, detail))
