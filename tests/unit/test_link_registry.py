"""Links by address: opened once, remembered, signed as asked, and left to whoever owns them."""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mavcal.service.errors import (
    EndpointError,
    EndpointRefused,
    LinkElsewhere,
    LinkOpen,
    LinkUnknown,
    PortBusy,
    SigningKeyUnknown,
)
from mavcal.service.link.allowed import Allowed
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.link.link import Link
from mavcal.service.link.types import LinkState
from mavcal.service.link_registry import LONGEST_PLAIN, LONGEST_URL, LinkRegistry, link_id_of
from mavcal.service.settings import DEFAULT, MavlinkSettings
from mavcal.service.signing_keys import SigningKeys
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import LinkRow

ONE, TWO = "1a" * 32, "2b" * 32
ANY_PORT = "udpin:127.0.0.1:0"


class Ownership:
    """Which links this instance may open; what it claimed and gave back."""

    def __init__(self) -> None:
        self.elsewhere: set[str] = set()
        self.said: list[tuple[str, str]] = []

    async def claim(self, link_id: str) -> None:
        self.said.append(("claim", link_id))
        if link_id in self.elsewhere:
            raise LinkElsewhere(f"link {link_id} is open at another instance")

    async def release(self, link_id: str) -> None:
        self.said.append(("release", link_id))


class Registry(LinkRegistry):
    """A registry on a store in memory that notes what it told of its links."""

    def __init__(self, folder: Path, **settings: object) -> None:
        self.told: list[tuple[str, str, LinkState]] = []
        self.owns = Ownership()
        self.store = SqliteStore(None)
        mavlink = MavlinkSettings.model_validate(settings)
        super().__init__(
            self.store,
            folder,
            mavlink,
            keys=SigningKeys(folder, mavlink),
            allowed=Allowed(DEFAULT, ()),
            attach=lambda link: self.told.append(("attach", link.id, link.state)),
            detach=lambda link: self.told.append(("detach", link.id, link.state)),
            ownership=self.owns,
        )

    @property
    def remembered(self) -> dict[str, str]:
        return {row.id: row.url for row in self.store.links()}


@pytest.fixture
async def make(tmp_path: Path) -> AsyncIterator[Callable[..., Registry]]:
    made: list[Registry] = []

    def registry(**settings: object) -> Registry:
        made.append(Registry(tmp_path, **settings))
        return made[-1]

    yield registry
    for one in made:
        await one.close_all()
        one.store.close()


@pytest.fixture
def registry(make: Callable[..., Registry]) -> Registry:
    return make()


@pytest.fixture
def busy() -> Iterator[str]:
    """An endpoint whose port another program uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        yield f"udpin:127.0.0.1:{opened.getsockname()[1]}"


async def test_a_link_is_opened_told_of_and_remembered(registry: Registry) -> None:
    link = await registry.open(ANY_PORT)
    assert (link.id, link.state) == ("udpin-127.0.0.1-0", LinkState.CONNECTING)
    assert registry.get(link.id) is link
    assert registry.all() == (link,)
    assert registry.told == [("attach", link.id, LinkState.CLOSED)]  # before a frame can come
    assert registry.remembered == {link.id: ANY_PORT}
    assert registry.owns.said == [("claim", link.id)]


async def test_the_same_place_is_opened_once_however_it_is_written(registry: Registry) -> None:
    link = await registry.open(ANY_PORT)
    assert await registry.open("UDP://127.0.0.1:0 ") is link
    assert registry.all() == (link,)
    assert len(registry.told) == 1
    assert registry.owns.said == [("claim", link.id)]  # it is ours already


async def test_links_are_listed_in_the_order_of_opening(registry: Registry) -> None:
    opened = [await registry.open(f"{kind}:127.0.0.{n}:0") for n, kind in ((3, "udpin"), (1, "tcpin"), (2, "udpin"))]
    assert registry.all() == tuple(opened)


async def test_we_are_on_the_wire_who_the_settings_say(make: Callable[..., Registry]) -> None:
    link = await make(system=77, component=191).open(ANY_PORT)
    assert (link.ids.system, link.ids.component) == (77, 191)


async def test_what_the_settings_name_is_not_remembered_and_may_be_anywhere(registry: Registry) -> None:
    with pytest.raises(EndpointRefused, match=r"192\.0\.2\.1 is not among .* links\.allowed"):
        await registry.open("udpout:192.0.2.1:14550")
    assert registry.owns.said == []
    link = await registry.open("udpout:192.0.2.1:14550", remember=False, trusted=True)
    assert registry.all() == (link,)
    assert registry.remembered == {}


async def test_a_link_that_does_not_open_leaves_nothing(registry: Registry, busy: str) -> None:
    with pytest.raises(PortBusy):
        await registry.open(busy)
    link_id = link_id_of(busy)
    assert registry.all() == ()
    assert registry.remembered == {}
    assert [what for what, _, _ in registry.told] == ["attach", "detach"]
    assert registry.owns.said == [("claim", link_id), ("release", link_id)]


async def test_another_instances_link_is_left_alone(registry: Registry) -> None:
    registry.owns.elsewhere.add(link_id_of(ANY_PORT))
    with pytest.raises(LinkElsewhere):
        await registry.open(ANY_PORT)
    assert (registry.all(), registry.told, registry.remembered) == ((), [], {})


async def test_a_closed_link_is_forgotten_and_given_back(registry: Registry) -> None:
    link = await registry.open(ANY_PORT)
    await registry.close(link.id)
    assert link.state is LinkState.CLOSED
    assert registry.all() == ()
    assert registry.remembered == {}
    assert registry.told[-1] == ("detach", link.id, LinkState.CLOSED)  # after the last frame was handed on
    assert registry.owns.said[-1] == ("release", link.id)
    with pytest.raises(LinkUnknown, match=f"there is no link {link.id}; GET /api/v1/links lists them"):
        await registry.close(link.id)


async def test_a_stop_closes_every_link_and_forgets_none(registry: Registry) -> None:
    opened = [await registry.open(ANY_PORT), await registry.open("udpin:127.0.0.2:0")]
    await registry.close_all()
    assert [link.state for link in opened] == [LinkState.CLOSED] * 2
    assert registry.all() == ()
    assert set(registry.remembered) == {link.id for link in opened}
    assert "release" not in dict(registry.owns.said)  # its leases are given back by the instance


async def test_a_link_that_was_lost_to_another_instance_is_closed_and_stays_remembered(registry: Registry) -> None:
    link = await registry.open(ANY_PORT)
    await registry.leave(link.id)
    await registry.leave(link.id)
    assert (link.state, registry.all()) == (LinkState.CLOSED, ())
    assert registry.remembered == {link.id: ANY_PORT}
    assert ("release", link.id) not in registry.owns.said  # it is not ours to give back


async def test_a_link_is_signed_with_the_key_it_names_and_its_id_does_not_tell(make: Callable[..., Registry]) -> None:
    registry = make(signing_keys={"boat": TWO}, signing_key=ONE)
    named = await registry.open(f"{ANY_PORT}?signing=boat")
    by_default = await registry.open("udpin:127.0.0.2:0")
    assert (named.signing_key, by_default.signing_key) == ("boat", "default")
    assert named.id == link_id_of(ANY_PORT)
    assert registry.remembered[named.id] == f"{ANY_PORT}?signing=boat"
    assert await registry.open(f"{ANY_PORT}?signing=boat") is named


async def test_an_open_link_is_not_given_out_as_one_with_another_key(make: Callable[..., Registry]) -> None:
    registry = make(signing_keys={"boat": TWO})
    plain = await registry.open(ANY_PORT)
    with pytest.raises(LinkOpen, match=f"{plain.id} is open and not signed, not signed with the key 'boat': close it"):
        await registry.open(f"{ANY_PORT}?signing=boat")
    await registry.close(plain.id)
    await registry.open(f"{ANY_PORT}?signing=boat")
    with pytest.raises(LinkOpen, match="is open and signed with the key 'boat', not not signed"):
        await registry.open(ANY_PORT)


async def test_a_key_that_is_not_known_opens_nothing(registry: Registry) -> None:
    with pytest.raises(SigningKeyUnknown):
        await registry.open(f"{ANY_PORT}?signing=plane")
    assert (registry.all(), registry.owns.said) == ((), [])


async def test_only_who_runs_the_service_may_leave_a_link_unsigned(make: Callable[..., Registry]) -> None:
    registry = make(signing_key=ONE)
    with pytest.raises(EndpointRefused, match="signing=none is for the settings and the command line alone"):
        await registry.open(f"{ANY_PORT}?signing=none")
    link = await registry.open(f"{ANY_PORT}?signing=none", trusted=True)
    assert link.signing_key is None


async def test_a_time_stamp_belongs_to_a_link_and_a_key(make: Callable[..., Registry]) -> None:
    """A stamp that went back would be taken for a replay, and one of another key says nothing."""
    registry = make(signing_keys={"boat": TWO, "plane": ONE}, signing_key=ONE)
    link = await registry.open(f"{ANY_PORT}?signing=boat")
    registry._keep_timestamp(link, 5000)
    await registry.store.do(lambda: None)  # it is kept in the background
    known = {name: registry.signing(link.id, name) for name in ("boat", "plane", None)}
    assert {name: found and found.timestamp for name, found in known.items()} == {"boat": 5000, "plane": 0, None: 0}
    other = registry.signing("udpin-127.0.0.2-0", "boat")
    assert other is not None
    assert other.timestamp == 0
    assert registry.signing(link.id, "none") is None


async def test_a_new_key_of_a_link_is_remembered_for_the_next_start(make: Callable[..., Registry]) -> None:
    registry = make(signing_keys={"boat": TWO})
    link = await registry.open(f"{ANY_PORT}?signing=boat")
    await registry.signed(link, "plane")
    assert str(link.endpoint) == f"{ANY_PORT}?signing=plane"
    assert registry.store.links() == (LinkRow(link.id, str(link.endpoint), registry.store.links()[0].at),)


@pytest.mark.parametrize("url", ["udpin:127.0.0.1:0?" + "x" * LONGEST_URL, "udpin:127.0.0.1:0\n", "file:a\0b"])
async def test_an_endpoint_is_short_and_printable(registry: Registry, url: str) -> None:
    with pytest.raises(EndpointError, match=f"at most {LONGEST_URL} printable characters"):
        await registry.open(url, trusted=True)
    with pytest.raises(EndpointError, match="printable"):
        link_id_of(url)


def test_an_endpoint_may_be_as_long_as_is_said() -> None:
    assert link_id_of("file:" + "a" * (LONGEST_URL - 5))
    with pytest.raises(EndpointError):
        link_id_of("file:" + "a" * (LONGEST_URL - 4))


PATHS = st.text(st.sampled_from("ab-/.:_ "), min_size=1, max_size=80).filter(lambda text: text.strip() == text)


@given(PATHS, PATHS)
@example(":", "-")
@example("a:1", "a-1")
def test_a_link_id_is_a_safe_file_name_and_no_two_endpoints_share_one(one: str, two: str) -> None:
    urls: list[str] = []
    for path in (one, two):
        try:
            urls.append(str(parse_endpoint(f"file:{path}")))
        except EndpointError:  # nothing is left of it behind two slashes
            return
    ids = [link_id_of(url) for url in urls]
    assert (ids[0] == ids[1]) is (urls[0] == urls[1])
    for link_id in ids:
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.-]*", link_id)
        assert len(link_id) <= LONGEST_PLAIN + 13


@pytest.mark.parametrize(
    ("url", "link_id"),
    [
        ("udpin:0.0.0.0:14550", "udpin-0.0.0.0-14550"),
        ("udp::14550", "udpin-0.0.0.0-14550"),
        ("sim:px4", "sim-px4"),
        ("tcp:10.0.0.1:5760?signing=boat", "tcp-10.0.0.1-5760"),
        ("file:" + "a" * (LONGEST_PLAIN - 5), "file-" + "a" * (LONGEST_PLAIN - 5)),
    ],
)
def test_the_id_of_a_plain_endpoint_is_the_endpoint(url: str, link_id: str) -> None:
    assert link_id_of(url) == link_id


def test_what_cannot_stand_in_a_name_is_told_apart_by_a_digest() -> None:
    assert re.fullmatch(r"serial-dev-ttyACM0-57600-[0-9a-f]{12}", link_id_of("serial:/dev/ttyACM0:57600"))
    assert link_id_of("serial:/dev/ttyACM0:57600") != link_id_of("serial:-dev-ttyACM0:57600")
    assert link_id_of("sim:px4?seed=1") != link_id_of("sim:px4?seed=2")


async def test_two_calls_at_once_open_one_link(registry: Registry) -> None:

    first, second = await asyncio.gather(registry.open(ANY_PORT), registry.open(ANY_PORT))
    assert isinstance(first, Link)
    assert first is second
    assert len(registry.told) == 1
