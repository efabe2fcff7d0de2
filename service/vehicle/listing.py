"""The complete parameter list of a vehicle, despite lost messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import ParamValue, decode_param_value
from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.parameters import HASH_CHECK, NO_INDEX
from mavcal.service.errors import ParameterTimeout, VehicleSilent
from mavcal.service.vehicle.exchange import Addressee
from mavcal.service.vehicle.parameter_bits import Parameter
from mavcal.service.vehicle.parameters import Parameters

PIPELINE = 10
"""Reads in flight: ArduPilot queues 20, answers 5 at a time, and drops the rest."""
_FIRST_S, _QUIET_S = 3.0, 1.5
_ANSWER_S, _NEXT_S = 1.0, 0.4
"""Time to wait for the first answer to a few reads, and for each further one, s."""
_LISTS = 3
_READS = 6

Progress = Callable[[int, int], None]
"""Called with how many values have come, and of how many."""


@dataclass(frozen=True)
class ParameterSet:
    """Every parameter that the vehicle lists, by name; hidden groups are not among them.

    `hash` is PX4's ``_HASH_CHECK`` (None on others); it does not cover calibrations.
    """

    parameters: Mapping[str, Parameter]
    hash: bytes | None

    def __len__(self) -> int:
        return len(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[name]

    def __contains__(self, name: object) -> bool:
        return name in self.parameters


class _Listing:
    """The received part of one parameter list. An index holds only as long as the length of the list stays the same."""

    def __init__(self) -> None:
        self.names: dict[int, str] = {}
        self.count = 0
        self.restart = False

    def take(self, heard: ParamValue) -> None:
        if heard.param_index == NO_INDEX or heard.name == HASH_CHECK or heard.param_index >= heard.param_count:
            return
        if self.count not in (0, heard.param_count) or self.names.get(heard.param_index, heard.name) != heard.name:
            self.restart = True
            self.names.clear()
        self.count = heard.param_count
        self.names[heard.param_index] = heard.name

    @property
    def missing(self) -> list[int]:
        return [index for index in range(self.count) if index not in self.names]

    @property
    def complete(self) -> bool:
        return self.count > 0 and len(self.names) == self.count and len(set(self.names.values())) == self.count


async def list_all(vehicle: Addressee, known: Parameters, progress: Progress | None = None) -> ParameterSet:
    """The whole list, read into `known`; missing entries are requested by index.

    One list is read at a time: two would take each other's values for their own.

    Raises
    ------
    ParameterTimeout
        If values are still missing after all retries; the message says how many.
    VehicleSilent
        If the vehicle's heartbeat has ceased.
    """
    listing = _Listing()

    def match(frame: Frame) -> bool:
        before = len(listing.names)
        listing.take(decode_param_value(frame))
        if progress is not None and len(listing.names) != before:
            progress(len(listing.names), listing.count)
        return True

    with vehicle.waits.expect({dialect.MAVLINK_MSG_ID_PARAM_VALUE}, match) as heard:
        for _ in range(_LISTS):
            listing.restart = False
            vehicle.send(dialect.MAVLink_param_request_list_message(vehicle.system, vehicle.component))
            quiet = _FIRST_S
            while not listing.complete and await heard.within(quiet):
                quiet = _QUIET_S
            for _ in range(_READS):
                if listing.complete or not listing.count or listing.restart:
                    break
                await _fill(vehicle, listing, heard.within)
            if listing.complete:
                parameters = {name: known[name] for name in listing.names.values() if name in known}  # of known types
                return ParameterSet(MappingProxyType(parameters), known.hash)
    raise _incomplete(vehicle, listing)


async def _fill(vehicle: Addressee, listing: _Listing, within: Callable[[float], object]) -> None:
    """Ask once for every missing index, a few at a time."""
    missing = listing.missing
    for start in range(0, len(missing), PIPELINE):
        asked = missing[start : start + PIPELINE]
        for index in asked:
            vehicle.send(dialect.MAVLink_param_request_read_message(vehicle.system, vehicle.component, b"", index))
        patience = _ANSWER_S
        while not listing.restart and any(index not in listing.names for index in asked):
            if not await within(patience):  # type: ignore[misc]
                break
            patience = _NEXT_S


def _incomplete(vehicle: Addressee, listing: _Listing) -> ParameterTimeout | VehicleSilent:
    if vehicle.silent:
        return VehicleSilent("The parameter list stopped: no heartbeat any more. Check power and link.")
    if not listing.count:
        return ParameterTimeout("The vehicle does not send its parameter list. Does another program block it?")
    return ParameterTimeout(
        f"{len(listing.missing)} of {listing.count} parameters were not received. The link loses too much."
    )
