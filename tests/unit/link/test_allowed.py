"""Which endpoints may be opened over the network."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pydantic import ValidationError

from mavcal.service.errors import EndpointRefused
from mavcal.service.link.allowed import Allowed
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.settings import DEFAULT, LinkSettings


def opened(text: str, entries: tuple[str, ...] = DEFAULT, *folders: Path) -> str:
    return str(Allowed(entries, folders).endpoint(parse_endpoint(text)))


@pytest.mark.parametrize(
    "text",
    [
        "udpin:0.0.0.0:14550",
        "udpin:[::]:14550",
        "tcpin:0.0.0.0:5770",
        "tcp:127.0.0.1:5760",
        "tcp:localhost:5760",
        "tcp:[::1]:5760",
        "udpout:192.168.2.2:14550",
        "tcp:10.1.2.3:1",
        "tcp:172.31.0.1:1",
        "tcp:[fd00::1]:1",
        "serial:/dev/ttyACM0:115200",
        "/dev/ttyUSB1,57600",
        "serial:/dev/serial/by-id/usb-ArduPilot_Pixhawk6X_1234-if00:115200",
        "serial:COM3:57600",
        "sim:px4?speed=2",
        'sim:px4?config={"thermal": false}',
    ],
)
def test_what_stands_on_a_bench_is_allowed_at_the_start(text):
    assert opened(text) == str(parse_endpoint(text))


@pytest.mark.parametrize(
    "text",
    [
        "tcp:8.8.8.8:80",
        "tcp:[2001:db8::1]:80",
        "tcp:[::ffff:8.8.8.8]:80",
        "tcp:169.254.169.254:80",
        "tcp:172.32.0.1:80",
        "tcp:example.com:80",
        "tcp:localhost.example.com:80",
        "tcp:2130706433:80",
        "tcp:0x7f.1:80",
        "tcp:127.1:80",
        "tcp:0.0.0.0:80",
        "udpout:255.255.255.255:14550",
        "udpin:8.8.8.8:14550",
        "serial:/etc/passwd:57600",
        "serial:/dev/zero:57600",
        "serial:/dev/tty1:57600",
        "serial:/dev/pts/0:57600",
        "serial:/dev/ttyS0/../zero:57600",
        "serial:/dev/serial/by-id/../../zero:57600",
        "sim:px4?params=/etc/passwd",
        "sim:px4?config=/etc/passwd",
        "file:/dev/zero",
        "file:/etc/passwd",
        "file:/nowhere",
    ],
)
def test_what_leads_elsewhere_is_refused(text):
    with pytest.raises(EndpointRefused) as refused:
        opened(text)
    assert refused.value.status_code == 403


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("any", "tcp:example.com:80"),
        ("any", "udpin:0.0.0.0:1"),
        ("8.8.0.0/16", "tcp:8.8.8.8:80"),
        ("8.8.8.8", "tcp:8.8.8.8:80"),
        ("drone.local", "tcp:Drone.local:5760"),
        ("/dev/pixhawk", "serial:/dev/pixhawk:57600"),
    ],
)
def test_the_settings_add_networks_hosts_and_devices(entry, text):
    settings = LinkSettings(allowed=(entry,))
    assert opened(text, settings.allowed)
    with pytest.raises(EndpointRefused):
        opened("serial:/dev/ttyACM0:57600", settings.allowed)


@pytest.mark.parametrize("entry", ["", "a b", "10.0.0.0/99", "-x", "/etc/passwd", "http://x"])
def test_an_entry_that_means_nothing_is_told_at_the_start(entry):
    with pytest.raises(ValidationError, match="is none of serial"):
        LinkSettings(allowed=(entry,))


def test_files_are_regular_and_inside_and_the_refusal_tells_no_more(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    for folder in (inside, outside):
        (folder / "a.tlog").write_bytes(b"x")
    os.mkfifo(inside / "pipe")
    (inside / "link").symlink_to(outside / "a.tlog")
    (outside / "back").symlink_to(inside / "a.tlog")
    assert opened(f"file:{inside}/a.tlog", DEFAULT, inside) == f"file:{inside}/a.tlog"
    assert opened(f"file:{outside}/back?speed=2", DEFAULT, inside) == f"file:{inside}/a.tlog?speed=2"
    assert opened(f"sim:px4?params={inside}/a.tlog", DEFAULT, inside)
    said = set()
    for path in (
        f"{outside}/a.tlog", f"{outside}/none", f"{inside}/none", f"{inside}", f"{inside}/pipe", f"{inside}/link",
        f"{inside}/../out/a.tlog", "/dev/zero", "/dev/null", "~/.ssh/id_rsa", "a\0b", "x" * 5000, f"{inside}/a.tlog/b",
    ):  # fmt: skip
        with pytest.raises(EndpointRefused) as refused:
            opened(f"file:{path}", DEFAULT, inside)
        said.add(str(refused.value))
    assert len(said) == 1
