"""Vehicles: identity, state with its evidence, streams, parameters and commands, on top of links."""

from __future__ import annotations

from mavcal.service.vehicle.commands import command
from mavcal.service.vehicle.encoding import Parameter
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.identity import Autopilot, VehicleIdentity
from mavcal.service.vehicle.intervals import set_interval
from mavcal.service.vehicle.listing import ParameterSet
from mavcal.service.vehicle.parameters import Echo, Parameters
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.state import Landed, Refusal, VehicleState, Writable, writable
from mavcal.service.vehicle.streams import StreamRate, StreamReport, request_streams
from mavcal.service.vehicle.vehicle import Vehicle

__all__ = [
    "Autopilot",
    "Echo",
    "Landed",
    "Parameter",
    "ParameterSet",
    "Parameters",
    "Refusal",
    "StreamRate",
    "StreamReport",
    "Vehicle",
    "VehicleEvent",
    "VehicleEventKind",
    "VehicleIdentity",
    "VehicleRegistry",
    "VehicleState",
    "Writable",
    "command",
    "request_streams",
    "set_interval",
    "writable",
]
