"""Links and vehicles, their parameters, and the state of their calibrations.

The signing keys of links never leave the service.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, SecretStr

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.states import SensorState
from mavcal.service.api.models.wire import Attitude, Number, Request, Wire
from mavcal.service.link.endpoint import Hand
from mavcal.service.link.types import LinkState
from mavcal.service.signing_keys import KnownKey
from mavcal.service.vehicle.identity import Airframe, Autopilot
from mavcal.service.vehicle.state import Landed


class LinkRequest(Request):
    """Open a link."""

    url: str = Field(description="an endpoint such as udpin:0.0.0.0:14550", examples=["udpin:0.0.0.0:14550"])


class LinkModel(BaseModel):
    """A link."""

    # A Link as far as it can be told, with its vehicles.
    id: str
    url: str
    state: LinkState
    reason: str = Field(description="why it is in that state")
    signing_key: str | None = Field(description="name of the key that signs it; null: it is not signed")
    vehicles: list[str] = Field(description="ids of the vehicles heard on it")
    crc_errors: int = Field(description="damaged frames, which cannot be attributed to a sender")


class SigningKeyRequest(Request):
    """Keep a signing key."""

    name: str = Field(min_length=1, max_length=64, description="what links call it: letters, digits, `.`, `_`, `-`")
    key: SecretStr | None = Field(default=None, description="64 hexadecimal digits; null: a new random key")


SigningKeyModel = Annotated[KnownKey, Wire("SigningKeyModel")]


class SigningRequest(Request):
    """Give the vehicle of a link a key."""

    key: str = Field(min_length=1, max_length=64, description="name of the key")


class VehicleModel(BaseModel):
    """A vehicle in one page."""

    # A Vehicle as far as it can be told.
    id: str
    link: str = Field(description="id of the link in use: everything is sent over it")
    links: list[str] = Field(description="ids of all links over which it was heard, the one in use first")
    system: int = Field(description="MAVLink system id")
    component: int = Field(description="MAVLink component id")
    autopilot: Autopilot
    airframe: Airframe = Field(description="the shape that a picture of it should have, from its MAV_TYPE")
    firmware: str = Field(description="version of the firmware; empty: not known yet")
    uid: str | None = Field(description="hardware id, hexadecimal; null: not known")
    armed: bool
    landed: Landed
    silent: bool = Field(description="no heartbeat for 3 s")
    writable: bool = Field(description="whether parameters may be written now")
    obstacles: list[str] = Field(description="why nothing may be written now")
    evidence: list[str] = Field(description="what the state rests on")
    texts: list[str] = Field(description="the last things that the vehicle said")
    received: int = Field(description="messages received")
    lost: int = Field(description="messages lost")
    loss: float = Field(description="lost share of everything sent, 0..1")
    bytes_per_s: float = Field(description="received, over the last seconds")
    hand: Hand | None = Field(description="who moves it, if it is a simulated vehicle; null: it is none")
    parameters_known: int = Field(description="how many parameters were heard")


class HandRequest(Request):
    """Who moves a simulated vehicle from now on."""

    hand: Hand


class TurnRequest(Request):
    """How a simulated vehicle is to be held."""

    attitude: Attitude = Field(description="quaternion w x y z, body (front right down) to north-east-down")


class ParameterModel(BaseModel):
    """A parameter as the vehicle states it."""

    # A Parameter without how the vehicle sent it; not finite is null.
    name: str
    value: Number | None = Field(description="in the unit that the firmware documents; null: not a finite number")
    kind: ParameterKind


SensorStateModel = Annotated[SensorState, Wire("SensorStateModel")]


class VehicleSensorsModel(BaseModel):
    """The four kinds of calibration of a vehicle, and what it needs now."""

    verdict: Verdict
    summary: str
    sensors: list[SensorStateModel]
