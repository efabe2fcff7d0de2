"""Simulated flight controllers that speak real MAVLink: ArduPilot and PX4 personalities in a process of their own.

An independent second implementation of the facts in `calib.firmware`. Nothing of `calib` or of the rest of `service` is
imported here, so that the two check each other.

A sample is made once per tick of the wall clock. `motion` (attitude, body rate) and `thermal` (temperature) drive
`sensors` (raw = M·true + b + p(T) + noise). `corrections` applies the firmware's own formulas with the parameters in
force. The personality (`ardupilot`, `px4`) quantises and packs what was asked for, `faults` spoils it, `links` sends
it. Units inside: s, m/s², rad/s, µT, °C, A; FRD body and NED frames; quaternions w x y z, body to NED.

Everything outside imports this package, and none of its modules: the rest of `service`, and tests of other ground
stations (docs/ground-station.md).
"""

from __future__ import annotations

from collections.abc import Sequence

from mavcal.service.simvehicle.client import ControlChannel, SimulatedVehicle, free_udp_port
from mavcal.service.simvehicle.errors import ControlError, SimulatedVehicleError, StartError
from mavcal.service.simvehicle.operator import Operator

__all__ = [
    "ControlChannel",
    "ControlError",
    "Operator",
    "SimulatedVehicle",
    "SimulatedVehicleError",
    "StartError",
    "flight_options",
    "fly",
    "free_udp_port",
    "options",
    "run",
]


def options() -> list[tuple[str, str]]:
    """What :func:`run` takes: each option with its values, and what it is for."""
    from mavcal.service.simvehicle.__main__ import described

    return described()


def flight_options() -> list[tuple[str, str]]:
    """What :func:`fly` takes: each option with its values, and what it is for."""
    from mavcal.service.simvehicle.__main__ import described
    from mavcal.service.simvehicle.flight.run import parser

    return described(parser())


def fly(arguments: Sequence[str]) -> int:
    """Run a simulated vehicle that flies until it is told to stop; returns the exit code."""
    from mavcal.service.simvehicle.flight.run import main

    return main(arguments)


def run(arguments: Sequence[str]) -> int:
    """Be a simulated vehicle until it is told to stop, as `python -m mavcal.service.simvehicle` is; the exit code."""
    # Imported here: who starts a vehicle in another process does without its sensors and numpy.
    from mavcal.service.simvehicle.__main__ import main

    return main(arguments)
