from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.service.errors import EndpointError
from mavcal.service.link.endpoint import FORMS, Endpoint, EndpointKind, Hand, parse_endpoint
from tests.examples import examples


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udpin 0.0.0.0 14550", "udpin:0.0.0.0:14550"),
        ("udpin 0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udpin://0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udp::14550", "udpin:0.0.0.0:14550"),
        (" UDPOUT:192.168.2.2:14550 ", "udpout:192.168.2.2:14550"),
        ("udpout:vehicle.local:14550?local_port=14555", "udpout:vehicle.local:14550?local_port=14555"),
        ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5760"),
        ("tcpout:127.0.0.1:5760", "tcp:127.0.0.1:5760"),
        ("tcp:[::1]:5760", "tcp:[::1]:5760"),
        ("tcpin:0.0.0.0:0", "tcpin:0.0.0.0:0"),
        ("serial:/dev/ttyACM0:57600", "serial:/dev/ttyACM0:57600"),
        ("serial:/dev/serial/by-id/usb-Cube_0:1-if00", "serial:/dev/serial/by-id/usb-Cube_0:1-if00:115200"),
        ("/dev/ttyACM0,115200", "serial:/dev/ttyACM0:115200"),
        ("/dev/ttyACM0", "serial:/dev/ttyACM0:115200"),
        ("COM7,57600", "serial:COM7:57600"),
        ("file:logs/flight 1.tlog", "file:logs/flight 1.tlog"),
        ("file:x.tlog?speed=0", "file:x.tlog?speed=0"),
        ("sim:ardupilot", "sim:ardupilot"),
        ("sim:px4?seed=3&speed=10", "sim:px4?seed=3&speed=10"),
    ],
)
def test_reads_every_form_and_writes_one(text: str, canonical: str) -> None:
    endpoint = parse_endpoint(text)
    assert str(endpoint) == canonical
    assert parse_endpoint(canonical) == endpoint


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "kind"),
        ("14550", "kind"),
        ("http://127.0.0.1:80", "'http' is not a kind"),
        ("udpin:0.0.0.0", "HOST:PORT"),
        ("udpin:0.0.0.0:99999", "99999 is no port"),
        ("tcp:127.0.0.1:0", "0 is no port"),
        ("tcp::5760", "host is missing"),
        ("tcp:a:b:c", "HOST:PORT"),
        ("serial:", "device"),
        ("serial:/dev/ttyACM0:3", "3 is no baud rate"),
        ("file:", ".tlog"),
        ("sim:betaflight", "ardupilot or px4"),
        ("sim:px4?sed=3", "'sed' is not an option"),
        ("tcp:1.2.3.4:5?x=1", "it takes signing"),
    ],
)
def test_refuses_with_the_reason_and_the_list(text: str, why: str) -> None:
    with pytest.raises(EndpointError) as caught:
        parse_endpoint(text)
    assert why in str(caught.value)
    assert all(form in str(caught.value) for form in FORMS)


def test_every_form_that_is_offered_is_accepted() -> None:
    assert {parse_endpoint(form).kind for form in FORMS} == set(EndpointKind)


def test_a_numeric_option_must_be_a_number() -> None:
    endpoint = parse_endpoint("sim:px4?speed=fast")
    with pytest.raises(EndpointError, match="speed=fast"):
        endpoint.number("speed", 1.0)
    assert Endpoint(EndpointKind.SIM, autopilot="px4").number("speed", 1.5) == 1.5


HOSTS = st.ip_addresses().map(str) | st.text("az09-.", min_size=1, max_size=12)
KEYS = st.text("Az09._ &=%+-", min_size=1, max_size=12)


@settings(max_examples=examples(50))
@given(st.sampled_from(["udpin", "udpout", "tcp", "tcpin"]), HOSTS, st.integers(1, 65535), st.none() | KEYS)
def test_an_endpoint_of_the_network_is_the_same_after_writing_and_reading(
    kind: str, host: str, port: int, key: str | None
) -> None:
    options = () if key is None else (("signing", key),)
    endpoint = Endpoint(EndpointKind(kind), host=host, port=port, options=options)
    assert parse_endpoint(str(endpoint)) == endpoint


@settings(max_examples=examples(50))
@given(st.text("az09_./:-", max_size=30), st.integers(1200, 12_000_000))
def test_a_device_is_the_same_after_writing_and_reading(name: str, baud: int) -> None:
    endpoint = Endpoint(EndpointKind.SERIAL, path=f"/dev/{name}x", baud=baud)
    assert parse_endpoint(str(endpoint)) == endpoint


@settings(max_examples=examples(50))
@given(st.text(max_size=40))
def test_whatever_is_no_endpoint_is_refused_with_the_forms(text: str) -> None:
    with pytest.raises(EndpointError) as refused:
        parse_endpoint(f"kind{text}")
    assert all(form in str(refused.value) for form in FORMS)


@pytest.mark.parametrize("number", ["1199", "12000001", "0"])
def test_a_baud_rate_has_bounds(number: str) -> None:
    assert parse_endpoint("serial:/dev/ttyACM0:1200").baud == 1200
    assert parse_endpoint("serial:/dev/ttyACM0:12000000").baud == 12_000_000
    with pytest.raises(EndpointError, match=f"{number} is no baud rate"):
        parse_endpoint(f"serial:/dev/ttyACM0:{number}")


@pytest.mark.parametrize(("kind", "listens"), [("udpin", True), ("tcpin", True), ("udpout", False), ("tcp", False)])
def test_only_who_listens_may_have_any_port_and_no_host(kind: str, listens: bool) -> None:
    assert parse_endpoint(f"{kind}:h:65535").port == 65535
    with pytest.raises(EndpointError, match="65536 is no port"):
        parse_endpoint(f"{kind}:h:65536")
    if listens:
        assert (parse_endpoint(f"{kind}:h:0").port, parse_endpoint(f"{kind}::5").host) == (0, "0.0.0.0")
        return
    with pytest.raises(EndpointError, match="0 is no port"):
        parse_endpoint(f"{kind}:h:0")
    with pytest.raises(EndpointError, match="the host is missing"):
        parse_endpoint(f"{kind}::5")


@pytest.mark.parametrize("url", FORMS)
def test_every_link_but_a_replayed_one_can_be_signed(url: str) -> None:
    if url.startswith("file:"):
        with pytest.raises(EndpointError, match="'signing' is not an option of file: it takes speed"):
            parse_endpoint(f"{url}?signing=boat")
    else:
        assert parse_endpoint(f"{url}?signing=boat").option("signing") == "boat"


def test_a_key_can_be_exchanged_and_taken_away_and_other_options_stay() -> None:
    endpoint = parse_endpoint("sim:px4?seed=3&signing=boat&speed=2")
    assert str(endpoint.place) == "sim:px4?seed=3&speed=2"
    assert str(endpoint.signed_with("plane")) == "sim:px4?seed=3&speed=2&signing=plane"
    assert endpoint.signed_with("plane").signed_with("boat").place == endpoint.place
    assert endpoint.place.option("signing") is None
    assert str(endpoint) == "sim:px4?seed=3&signing=boat&speed=2"


@pytest.mark.parametrize(
    ("url", "hand"),
    [
        ("sim:px4", Hand.AUTO),
        ("sim:px4?hand=mouse", Hand.MOUSE),
        ("sim:ardupilot?hand=off", Hand.OFF),
        ("udpin:0.0.0.0:14550", None),
        ("file:a.tlog", None),
    ],
)
def test_only_a_simulated_vehicle_is_moved_by_somebody(url: str, hand: Hand | None) -> None:
    assert parse_endpoint(url).hand is hand


def test_who_moves_it_is_one_of_those_that_are_offered() -> None:
    with pytest.raises(EndpointError, match="hand is 'left' and not one of auto, mouse, off"):
        parse_endpoint("sim:px4?hand=left")


def test_an_empty_option_is_no_number() -> None:
    with pytest.raises(EndpointError, match=r"speed= in sim:px4\?speed= is not a number"):
        parse_endpoint("sim:px4?speed=").number("speed", 1.0)
    assert parse_endpoint("sim:px4?speed=2e1").number("speed", 1.0) == 20.0
