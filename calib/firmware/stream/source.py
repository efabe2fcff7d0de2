"""Whether a recording was made from a stream of messages, or by the vehicle's own logger."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.stream.auxiliary import Auxiliary
from mavcal.calib.firmware.stream.messages import INERTIAL

if TYPE_CHECKING:
    from mavcal.calib.recording import Recording

STREAMED: Final = frozenset(
    str(dialect.mavlink_map[number].msgname)
    for number in {*(n for messages in INERTIAL.values() for n in messages), *Auxiliary.message_ids}
)
"""Sources of the channels that messages of MAVLink bring. No logger on board calls its own so."""


def telemetry(recording: Recording) -> bool:
    """Whether the samples came over a link: what they are and how often is set by stream rates, not by a logger."""
    return any(channel.source in STREAMED for channel in recording.channels)
