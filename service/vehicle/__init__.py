"""Vehicles: identity, state with its evidence, streams, parameters and commands, on top of links."""

from __future__ import annotations

from service.vehicle.commands import command
from service.vehicle.encoding import Parameter, ParameterEncoding, ParameterKind
from service.vehicle.events import VehicleEvent, VehicleEventKind
from service.vehicle.identity import Autopilot, VehicleIdentity
from service.vehicle.listing import ParameterSet
from service.vehicle.parameters import Echo, Parameters
from service.vehicle.registry import VehicleRegistry
from service.vehicle.state import Landed, Refusal, VehicleState, Writable, writable
from service.vehicle.streams import StreamRate, StreamReport, measure, request_streams, set_interval
from service.vehicle.vehicle import Vehicle

__all__ = [
    "Autopilot",
    "Echo",
    "Landed",
    "Parameter",
    "ParameterEncoding",
    "ParameterKind",
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
    "measure",
    "request_streams",
    "set_interval",
    "writable",
]
