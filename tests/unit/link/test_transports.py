"""What the system says when a link cannot be opened, in words that say what to do."""

from __future__ import annotations

import errno
import socket

import pytest

from mavcal.service.errors import EndpointError, LinkDown, PortBusy, ServiceError
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.link.transports import open_error, resolve

ENDPOINT = parse_endpoint("tcpin:10.0.0.9:5770")


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (errno.EADDRINUSE, PortBusy, "another program uses port 5770. Stop it, or let it forward to another port"),
        (errno.EADDRNOTAVAIL, EndpointError, "this machine has no address 10.0.0.9. To listen use 0.0.0.0."),
        (errno.EACCES, EndpointError, "not allowed. Use a port above 1023, or give this user the right."),
        (errno.EPERM, EndpointError, "not allowed. Use a port above 1023, or give this user the right."),
        (errno.ECONNREFUSED, LinkDown, "Connection refused. Is the vehicle, or its simulator, running there?"),
        (errno.EHOSTUNREACH, LinkDown, "No route to host. Is the vehicle, or its simulator, running there?"),
    ],
)
def test_an_error_of_the_system_becomes_one_of_ours_with_the_remedy(
    number: int, kind: type[ServiceError], said: str
) -> None:
    made = open_error(OSError(number, "what the system calls it"), ENDPOINT)
    assert type(made) is kind
    assert str(made).startswith(f"tcpin:10.0.0.9:5770: {said}")


@pytest.mark.parametrize(("raised", "said"), [(TimeoutError(), "timed out"), (OSError("no luck"), "no luck")])
def test_an_error_without_a_number_is_worth_another_try(raised: OSError, said: str) -> None:
    made = open_error(raised, ENDPOINT)
    assert type(made) is LinkDown
    assert f": {said}. Is the vehicle" in str(made)


def test_an_address_is_resolved_to_itself_in_its_family() -> None:
    assert resolve(("127.0.0.1", 5760), socket.SOCK_STREAM, ENDPOINT) == (socket.AF_INET, ("127.0.0.1", 5760))
    assert resolve(("::1", 1), socket.SOCK_DGRAM, ENDPOINT) == (socket.AF_INET6, ("::1", 1))


def test_a_host_of_both_families_is_reached_by_the_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulators listen on 127.0.0.1 alone, while `localhost` may be ::1 first."""
    both = [
        (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 5760, 0, 0)),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", 5760)),
    ]
    for found in (both, both[::-1]):
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, found=found, **__: found)
        assert resolve(("localhost", 5760), socket.SOCK_STREAM, ENDPOINT) == (socket.AF_INET, ("127.0.0.1", 5760))


@pytest.mark.parametrize(
    ("host", "said"), [("no-such-host.invalid", "is not known. Check its name"), ("a" * 70, "is not a host name")]
)
def test_a_name_that_leads_nowhere_is_refused_with_the_name(host: str, said: str) -> None:
    with pytest.raises(EndpointError) as refused:
        resolve((host, 5760), socket.SOCK_STREAM, ENDPOINT)
    assert repr(host) in str(refused.value)
    assert said in str(refused.value)
