"""Endpoints: the strings that name a link.

BlueOS, mavutil, MAVSDK and QGroundControl spell them slightly differently; all spellings are read, and ``str()`` gives
one form.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import StrEnum
from urllib.parse import parse_qsl, urlencode

from mavcal.service.errors import EndpointError

FORMS = (
    "udpin:0.0.0.0:14550",
    "udpout:192.168.2.2:14550",
    "tcp:127.0.0.1:5760",
    "tcpin:0.0.0.0:5770",
    "serial:/dev/ttyACM0:115200",
    "file:flight.tlog",
    "sim:ardupilot",
    "sim:px4",
)
"""One example of every form; part of every refusal."""

DEFAULT_BAUD = 115200
SIMULATED = ("ardupilot", "px4")


class EndpointKind(StrEnum):
    """Transport to the vehicle."""

    UDPIN = "udpin"  # wait on a port for whoever speaks
    UDPOUT = "udpout"  # speak first, to one address
    TCP = "tcp"  # connect
    TCPIN = "tcpin"  # wait to be connected to
    SERIAL = "serial"
    FILE = "file"  # replay a .tlog
    SIM = "sim"  # start a simulated vehicle


class Hand(StrEnum):
    """Who moves a simulated vehicle."""

    AUTO = "auto"
    """It does by itself what the prompts of its jobs ask for."""
    MOUSE = "mouse"
    """A person, in the panel."""
    OFF = "off"
    """Nobody: it stays where it is put."""


_ALIASES = {"udp": EndpointKind.UDPIN, "tcpout": EndpointKind.TCP}
_NETWORK = {EndpointKind.UDPIN, EndpointKind.UDPOUT, EndpointKind.TCP, EndpointKind.TCPIN}
SIGNING = "signing"
"""Option that names the key of a link."""
_OPTIONS = {
    EndpointKind.UDPIN: {SIGNING},
    EndpointKind.UDPOUT: {"local_port", SIGNING},
    EndpointKind.TCP: {SIGNING},
    EndpointKind.TCPIN: {SIGNING},
    EndpointKind.SERIAL: {SIGNING},
    EndpointKind.FILE: {"speed"},
    EndpointKind.SIM: {"seed", "speed", "system_id", "script", "config", "params", "hand", SIGNING},
}
"""Options allowed after a ``?``. PX4 keeps answering one client port; ``local_port`` keeps ours constant."""


@dataclass(frozen=True)
class Endpoint:
    """A parsed endpoint; ``str()`` is its canonical form.

    `host` and `port` belong to the network kinds, `path` to serial and file, `baud` to serial, `autopilot` to sim.
    """

    kind: EndpointKind
    host: str = ""
    port: int = 0
    path: str = ""
    baud: int = 0
    autopilot: str = ""
    options: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        if self.kind in _NETWORK:
            host = f"[{self.host}]" if ":" in self.host else self.host
            where = f"{host}:{self.port}"
        elif self.kind is EndpointKind.SERIAL:
            where = f"{self.path}:{self.baud}"
        else:
            where = self.path or self.autopilot
        return f"{self.kind}:{where}{'?' + urlencode(self.options) if self.options else ''}"

    @property
    def place(self) -> Endpoint:
        """The endpoint without the name of its key."""
        return self.signed_with(None)

    def signed_with(self, name: str | None) -> Endpoint:
        """The same endpoint with the key of another name; None: it names none."""
        others = tuple(option for option in self.options if option[0] != SIGNING)
        return replace(self, options=others if name is None else (*others, (SIGNING, name)))

    def option(self, name: str) -> str | None:
        """The value of one option behind the ``?``, or None."""
        return dict(self.options).get(name)

    @property
    def hand(self) -> Hand | None:
        """Who moves the simulated vehicle at first; None: the endpoint is no simulated vehicle."""
        return Hand(self.option("hand") or Hand.AUTO) if self.kind is EndpointKind.SIM else None

    def number(self, name: str, default: float) -> float:
        """The value of a numeric option. Raises EndpointError if it is not a number."""
        text = self.option(name)
        try:
            return default if text is None else float(text)
        except ValueError as exc:
            raise EndpointError(f"{name}={text} in {self} is not a number") from exc


def parse_endpoint(text: str) -> Endpoint:
    """Read an endpoint string.

    Raises
    ------
    EndpointError
        With what is wrong and the list of known forms.
    """
    stripped = text.strip()
    device = re.fullmatch(r"(/dev/[^\s,?]+|COM\d+)(?:,(\d+))?", stripped)
    if device:
        return Endpoint(EndpointKind.SERIAL, path=device[1], baud=_baud(device[2], text))
    match = re.fullmatch(r"([A-Za-z0-9_]+)(?::|\s+)(.*)", stripped)
    if not match:
        raise _refused(text, "it does not begin with a kind and a colon")
    word, rest = match[1].lower(), match[2]
    kind = _ALIASES.get(word) or (EndpointKind(word) if word in set(EndpointKind) else None)
    if kind is None:
        raise _refused(text, f"'{word}' is not a kind of link")
    where, _, query = rest.partition("?")
    options = _options(kind, query, text)
    where = where.removeprefix("//").strip()
    if kind in _NETWORK:
        host, port = _host_port(where, kind, text)
        return Endpoint(kind, host=host, port=port, options=options)
    if kind is EndpointKind.SERIAL:
        named = re.fullmatch(r"(.*?)(?:[:,](\d+))?", where)
        path, baud = (named[1], named[2]) if named else (where, None)
        return Endpoint(kind, path=_named(path, "a device", text), baud=_baud(baud, text), options=options)
    if kind is EndpointKind.FILE:
        return Endpoint(kind, path=_named(where, "a .tlog file", text), options=options)
    if where not in SIMULATED:
        raise _refused(text, f"sim: takes {' or '.join(SIMULATED)}")
    hand = dict(options).get("hand", Hand.AUTO)
    if hand not in set(Hand):
        raise _refused(text, f"hand is {hand!r} and not one of {', '.join(Hand)}")
    return Endpoint(kind, autopilot=where, options=options)


def _refused(text: str, why: str) -> EndpointError:
    return EndpointError(f"{text!r} is not an endpoint: {why}. Known forms: {', '.join(FORMS)}")


def _named(path: str, what: str, text: str) -> str:
    if not path:
        raise _refused(text, f"the name of {what} is missing")
    return path


def _baud(digits: str | None, text: str) -> int:
    baud = int(digits) if digits else DEFAULT_BAUD
    if not 1200 <= baud <= 12_000_000:
        raise _refused(text, f"{baud} is no baud rate")
    return baud


def _host_port(where: str, kind: EndpointKind, text: str) -> tuple[str, int]:
    match = re.fullmatch(r"(\[[^\]]*\]|[^:\s]*)(?::|\s+)(\d{1,5})", where)
    if not match:
        raise _refused(text, "it needs HOST:PORT")
    host, port = match[1].strip("[]"), int(match[2])
    if not host and kind in (EndpointKind.UDPIN, EndpointKind.TCPIN):
        host = "0.0.0.0"  # noqa: S104 - what "udpin::14550" means everywhere
    if not host:
        raise _refused(text, "the host is missing")
    listening = kind in (EndpointKind.UDPIN, EndpointKind.TCPIN)
    if not (0 if listening else 1) <= port <= 65535:
        raise _refused(text, f"{port} is no port")
    return host, port


def _options(kind: EndpointKind, query: str, text: str) -> tuple[tuple[str, str], ...]:
    options = tuple(parse_qsl(query, keep_blank_values=True))
    known = _OPTIONS.get(kind, set())
    for name, _ in options:
        if name not in known:
            what = f"it takes {', '.join(sorted(known))}" if known else "it takes none"
            raise _refused(text, f"'{name}' is not an option of {kind}: {what}")
    return options
