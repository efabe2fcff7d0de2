"""Keys of a running service: what is kept, what is refused, and what a vehicle is given."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from mavcal.service.errors import (
    Forbidden,
    LinkOpen,
    SigningKeyError,
    SigningKeyUnknown,
    SigningNotConfirmed,
    VehicleArmed,
)
from mavcal.service.settings import MavlinkSettings
from mavcal.service.signing import SigningAdmin
from mavcal.service.signing_keys import SigningKeys
from mavcal.service.store import SqliteStore

DIGITS = "ab" * 32


class Link:
    """A link that is signed or not; its vehicle takes a key that is offered, or does not."""

    def __init__(self, name, signing_key=None, *, takes=True):
        self.id, self.signing_key, self.takes = name, signing_key, takes
        self.offered = []

    async def offer_key(self, signing, address):
        self.offered.append((signing, address))
        return self.takes


class Links:
    """Links by id."""

    def __init__(self, *links):
        self.links = {link.id: link for link in links}

    def all(self):
        return list(self.links.values())

    def get(self, link_id):
        return self.links[link_id]

    def signing(self, link_id, key):
        return None if key == "none" else ("signing", link_id, key)

    async def signed(self, link, key):
        link.signing_key = key


def vehicle(link, *, armed=False):
    def require_writable(*, name):
        if armed:
            raise VehicleArmed(f"{name} is not given to an armed vehicle")

    return SimpleNamespace(
        id="v1", link=link, links=(link,), system=1, component=190, require_writable=require_writable
    )


@pytest.fixture
def store():
    made = SqliteStore(None)
    yield made
    made.close()


@pytest.fixture
def make(tmp_path, store):
    def admin(*links, vehicles=(), read_only=False):
        keys = SigningKeys(tmp_path, MavlinkSettings())
        there = SimpleNamespace(all=lambda: list(vehicles))
        return SigningAdmin(keys, Links(*links), there, store, read_only=read_only)

    return admin


def trail(store):
    return [(row.actor, row.action, row.subject, dict(row.detail)) for row in store.audit()]


async def test_a_key_is_kept_and_noted_by_its_fingerprint_alone(make, store):
    known = await make().add("boat", DIGITS, "me")
    assert [key.name for key in await make().all()] == ["boat"]
    assert trail(store) == [("me", "signing key added", "boat", {"fingerprint": known.fingerprint})]
    assert DIGITS not in repr(trail(store)) + repr(known)


async def test_a_key_may_be_made_here(make):
    admin = make()
    first, second = await admin.add("a", None, "me"), await admin.add("b", None, "me")
    assert first.fingerprint != second.fingerprint


async def test_a_key_that_signs_a_link_stays(make, store):
    admin = make(Link("l1", "boat"), Link("l2", "boat"), Link("l3", "tug"), Link("l4"))
    await admin.add("boat", DIGITS, "me")
    with pytest.raises(SigningKeyError, match="in use by l1, l2: close that link first"):
        await admin.remove("boat", "me")
    assert [key.name for key in await admin.all()] == ["boat"]


async def test_a_key_that_is_removed_is_gone_and_noted(make, store):
    admin = make(Link("l1"))
    known = await admin.add("boat", DIGITS, "me")
    await admin.remove("boat", "you")
    assert await admin.all() == ()
    assert trail(store)[-1] == ("you", "signing key removed", "boat", {"fingerprint": known.fingerprint})
    with pytest.raises(SigningKeyUnknown):
        await admin.remove("boat", "you")
    assert len(trail(store)) == 2


async def test_the_one_vehicle_of_a_link_is_given_the_key_and_the_link_is_signed(make, store):
    link, other = Link("l1"), Link("l2")
    admin = make(link, other, vehicles=[vehicle(link), vehicle(other)])
    assert await admin.set_up("l1", "boat", "me") is link
    assert link.offered == [(("signing", "l1", "boat"), (1, 190))]
    assert (link.signing_key, other.signing_key) == ("boat", None)
    detail = {"key": "boat", "vehicle": "v1"}
    assert trail(store) == [("me", "signing set up", "l1", detail), ("me", "signing confirmed", "l1", detail)]


async def test_a_vehicle_that_does_not_sign_leaves_the_link_as_it_was(make, store):
    link = Link("l1", takes=False)
    with pytest.raises(SigningNotConfirmed, match=r"the link stays unsigned.*\?signing=boat"):
        await make(link, vehicles=[vehicle(link)]).set_up("l1", "boat", "me")
    assert link.signing_key is None
    assert [action for _, action, *_ in trail(store)] == ["signing set up"]  # that it was given is known


@pytest.mark.parametrize(
    ("link", "vehicles", "key", "error"),
    [
        (Link("l1", "tug"), 1, "boat", LinkOpen),
        (Link("l1"), 0, "boat", SigningKeyError),
        (Link("l1"), 2, "boat", SigningKeyError),
        (Link("l1"), 1, "none", SigningKeyError),
    ],
)
async def test_nothing_is_sent_where_the_key_would_not_do(make, store, link, vehicles, key, error):
    with pytest.raises(error):
        await make(link, vehicles=[vehicle(link)] * vehicles).set_up("l1", key, "me")
    assert (link.offered, trail(store)) == ([], [])


async def test_an_armed_vehicle_and_a_service_that_never_writes_are_left_alone(make, store):
    link = Link("l1")
    with pytest.raises(VehicleArmed, match="The signing key"):
        await make(link, vehicles=[vehicle(link, armed=True)]).set_up("l1", "boat", "me")
    with pytest.raises(Forbidden, match="read-only"):
        await make(link, vehicles=[vehicle(link)], read_only=True).set_up("l1", "boat", "me")
    assert (link.offered, trail(store)) == ([], [])
