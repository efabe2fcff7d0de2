"""Types of a link: batches of frames, its state, its statistics, and its events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import DiskFull

Address = tuple[str, int]
"""Host and port of a peer; a serial device or a file is ``(path, 0)``."""

GROUND_SYSTEM, GROUND_COMPONENT = 253, 190
"""Our default ids: 255 belongs to the ground station, 190 is a ground station's component (mavlink.io)."""


@dataclass(frozen=True)
class OwnIdentity:
    """The ids that this program speaks with, and how it introduces itself.

    The defaults are those of a ground tool (MAV_TYPE_GCS); on board use the vehicle's own `system`, a component of
    191 to 194 and ``type=18`` (MAV_TYPE_ONBOARD_CONTROLLER).
    """

    system: int = GROUND_SYSTEM
    component: int = GROUND_COMPONENT
    type: int = 6


@dataclass(frozen=True)
class SigningConfig:
    """How frames are signed and which are believed.

    Parameters
    ----------
    key : 32 bytes
        Shared with the vehicle.
    link_id
        Distinguishes this link's time stamps from those of others with the same key.
    timestamp
        The newest time stamp of the last run, as given to the store callback; 0 for none.
    accept_unsigned
        Message ids that may come unsigned; radios cannot sign their RADIO_STATUS (109).
    """

    key: bytes = field(repr=False)
    link_id: int = 0
    timestamp: int = 0
    accept_unsigned: frozenset[int] = frozenset({109})
    name: str = ""
    """What the key is called; never the key itself."""


class LinkState(StrEnum):
    """Where a link stands; the reason is a sentence beside it."""

    CONNECTING = "connecting"  # open, or being opened; nobody was heard yet
    UP = "up"  # connected; on a datagram link somebody was heard
    DOWN = "down"  # not connected; tries again by itself unless a recording has ended
    CLOSED = "closed"


class LinkEventKind(StrEnum):
    """What happened on a link."""

    STATE = "state"
    PEER_CHANGED = "peer_changed"  # a known vehicle speaks from another address
    DUPLICATE_SYSTEM = "duplicate_system"  # two addresses take turns with one system id
    OWN_IDS_HEARD = "own_ids_heard"  # somebody else speaks with our ids
    TLOG = "tlog"  # recording stopped, or goes on
    SIGNING_CONFIRMED = "signing_confirmed"  # a frame came that is signed with the key that was offered
    OVERRUN = "overrun"  # frames were recorded but not delivered
    SIGNATURE_REFUSED = "signature_refused"


@dataclass(frozen=True)
class LinkEvent:
    """One sentence about a link; `system` and `component` name the sender it is about, 0 for none."""

    kind: LinkEventKind
    text: str
    system: int = 0
    component: int = 0
    addresses: tuple[Address, ...] = ()


@dataclass(frozen=True)
class Batch:
    """Frames that arrived together.

    Frames hold every message that any subscriber asked for, of every sender, in order. Their records, and those of
    all messages left out here, are in the link's .tlog between the byte positions `tlog_start` and `tlog_end`.
    """

    frames: tuple[Frame, ...]
    received_at: float
    """When the reader thread had the last of them, monotonic clock, s; the event loop may be late."""
    tlog_start: int
    tlog_end: int
    tlog_error: DiskFull | None = None
    """Not None while frames cannot be recorded: whoever needs the recording has to stop."""
    since: float | None = None
    """None of them arrived before this time, s: the reader had looked then; None: they arrived at `received_at`."""


@dataclass(frozen=True)
class LinkStatistics:
    """What came from one sender. Rates are over about the last second.

    `lost_inferred` is the part of `lost` beyond what the 8-bit sequence can show (multiples of 256). It is inferred
    from the sender's rate or the socket's own count of dropped datagrams. Damage cannot be attributed to a sender:
    `crc_errors` counts for the whole link.
    """

    received: int = 0
    bytes_received: int = 0
    lost: int = 0
    lost_inferred: int = 0
    duplicated: int = 0
    out_of_order: int = 0
    crc_errors: int = 0
    bytes_per_s: float = 0.0
    frames_per_s: float = 0.0

    @property
    def loss(self) -> float:
        """Lost share of everything sent, 0..1."""
        sent = self.received + self.lost
        return self.lost / sent if sent else 0.0


BatchCallback = Callable[[Batch], None]
EventCallback = Callable[[LinkEvent], None]
