from __future__ import annotations

import pytest

from mavcal.service.errors import EndpointError
from mavcal.service.link import Endpoint, EndpointKind, parse_endpoint
from mavcal.service.link.endpoint import FORMS


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
