"""Who a vehicle is: HEARTBEAT says what kind, AUTOPILOT_VERSION says which one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.device_ids import unit_id
from mavcal.calib.wire.codec import Message
from mavcal.calib.wire.parameters import ParameterEncoding, usual_encoding


class Autopilot(StrEnum):
    """The firmware family."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
    OTHER = "other"


class Airframe(StrEnum):
    """The shape that a picture of a vehicle has."""

    MULTIROTOR = "multirotor"
    PLANE = "plane"
    BOAT = "boat"  # and whatever else stays on the ground


_PLANES = {
    dialect.MAV_TYPE_FIXED_WING,
    dialect.MAV_TYPE_FLAPPING_WING,
    *range(dialect.MAV_TYPE_VTOL_DUOROTOR, dialect.MAV_TYPE_VTOL_RESERVED5 + 1),
}
_ON_THE_GROUND = {dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_TYPE_SUBMARINE}
_AUTOPILOTS = {
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: Autopilot.ARDUPILOT,
    dialect.MAV_AUTOPILOT_PX4: Autopilot.PX4,
}
_BYTEWISE, _CAST = 16, 131072
_RELEASE = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}


@dataclass(frozen=True)
class VehicleIdentity:
    """Identity as far as it is known.

    Parameters
    ----------
    autopilot, vehicle_type
        From HEARTBEAT; the type is a MAV_TYPE.
    version, version_text, git_hash
        Firmware version as numbers and as text with the hash; None and empty until AUTOPILOT_VERSION has come.
    board, vendor, product
        Hardware numbers as the firmware gives them.
    uid2
        Unique id in hexadecimal, trailing zeros cut; None if unknown, or if every vehicle of its kind says the same.
    capabilities
        MAV_PROTOCOL_CAPABILITY bits, or None.
    """

    autopilot: Autopilot
    vehicle_type: int
    version: tuple[int, int, int] | None = None
    version_text: str = ""
    git_hash: str = ""
    board: int = 0
    vendor: int = 0
    product: int = 0
    uid2: str | None = None
    capabilities: int | None = None

    @property
    def known(self) -> bool:
        """True once AUTOPILOT_VERSION has come."""
        return self.capabilities is not None

    @property
    def airframe(self) -> Airframe:
        """Airframe to draw: a multirotor, if nothing else is known."""
        if self.vehicle_type in _PLANES:
            return Airframe.PLANE
        return Airframe.BOAT if self.vehicle_type in _ON_THE_GROUND else Airframe.MULTIROTOR

    @property
    def encoding(self) -> ParameterEncoding:
        """How parameter values travel: bit 16 is asked first, since not every firmware sets the other one."""
        if self.capabilities is not None:
            if self.capabilities & _BYTEWISE:
                return ParameterEncoding.BYTEWISE
            if self.capabilities & _CAST:
                return ParameterEncoding.CAST
        return usual_encoding(self.autopilot)


def identity_from_heartbeat(message: Message) -> VehicleIdentity:
    """The identity that a HEARTBEAT states."""
    return VehicleIdentity(_AUTOPILOTS.get(message.autopilot, Autopilot.OTHER), message.type)


def identity_from_version(known: VehicleIdentity, message: Message) -> VehicleIdentity:
    """The identity with the fields of AUTOPILOT_VERSION filled in."""
    number = message.flight_sw_version
    version = (number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF)
    kind = _RELEASE.get(number & 0xFF, f"-{number & 0xFF}")
    git_hash = _git_hash(known.autopilot, bytes(message.flight_custom_version))
    text = ".".join(map(str, version)) + kind
    return VehicleIdentity(
        autopilot=known.autopilot,
        vehicle_type=known.vehicle_type,
        version=version,
        version_text=f"{text} ({git_hash})" if git_hash else text,
        git_hash=git_hash,
        board=message.board_version,
        vendor=message.vendor_id,
        product=message.product_id,
        uid2=unit_id(known.autopilot, bytes(message.uid2), message.uid),
        capabilities=message.capabilities,
    )


def _git_hash(autopilot: Autopilot, custom: bytes) -> str:
    """ArduPilot sends eight characters, PX4 the leading eight bytes of the hash, last byte first."""
    if autopilot is Autopilot.ARDUPILOT:
        text = custom.split(b"\x00", 1)[0].decode("ascii", "replace")
        return text if text.isalnum() else ""
    return custom[::-1].hex() if any(custom) else ""
