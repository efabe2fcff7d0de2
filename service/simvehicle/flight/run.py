"""``mavcal simulate flight``: a simulated vehicle that flies, as a process of its own."""

from __future__ import annotations

import argparse
import json
import select
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mavcal.service.simvehicle.errors import ConfigurationError, SimulatedVehicleError
from mavcal.service.simvehicle.flight.flightlog import FlightLog
from mavcal.service.simvehicle.flight.frame import Frame, load_frame
from mavcal.service.simvehicle.flight.ground import GroundLink
from mavcal.service.simvehicle.flight.modes import LOOP_HZ
from mavcal.service.simvehicle.flight.parameters import FlightParameters, load_parameters
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.links import SimEndpoint, TcpServer, UdpIn

SLICE = 8
"""Loops between two looks at the link: 20 ms of vehicle time."""
_WAIT_S = 0.2
_BEHIND_S = 0.5
"""Delay beyond which a process does not catch up, wall seconds."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="mavcal simulate flight", description=__doc__)
    p.add_argument("--port", type=int, required=True, metavar="NUMBER", help="on loopback; 0: any free one")
    p.add_argument("--log", required=True, metavar="FILE", help="the DataFlash log that it writes")
    p.add_argument("--frame", default=None, metavar="FILE", help="JSON with the keys of SITL's frame files")
    p.add_argument("--params", default=None, metavar="FILE", help="parameters, NAME VALUE a line")
    p.add_argument("--speedup", type=float, default=0.0, metavar="FACTOR", help="at most; 0: as fast as it goes")
    p.add_argument("--udp", action="store_true", help="listen on UDP instead of TCP")
    p.add_argument("--seed", type=int, default=1, metavar="NUMBER", help="of noise and gusts")
    return p


def main(argv: Sequence[str]) -> int:
    """Wait for a ground station, then fly until SIGTERM. Exit code 2: wrong use."""
    args = parser().parse_args(argv)
    try:
        frame = Frame() if args.frame is None else load_frame(args.frame)
        parameters = FlightParameters({} if args.params is None else load_parameters(args.params))
        vehicle = FlyingVehicle(frame, parameters, _log(args.log), seed=args.seed)
        address = f"127.0.0.1:{args.port}"
        endpoint: SimEndpoint = UdpIn(address, first_for_ever=False) if args.udp else TcpServer(address)
    except SimulatedVehicleError as error:
        print(f"mavcal simulate flight: {error}", file=sys.stderr)  # noqa: T201 - the command line's own voice
        return 2
    print(json.dumps({"ready": True, "url": endpoint.url}), flush=True)  # noqa: T201
    FlightLoop(vehicle, endpoint, args.speedup).run()
    return 0


def _log(path: str) -> FlightLog:
    try:
        return FlightLog(Path(path))
    except OSError as error:
        raise ConfigurationError(f"log {path} cannot be written: {error.strerror}") from error


class FlightLoop:
    """Runs vehicle time at up to the wanted speed; it begins when a ground station is first heard, as SITL's does."""

    def __init__(self, vehicle: FlyingVehicle, endpoint: SimEndpoint, speedup: float) -> None:
        self._vehicle, self._endpoint, self._speedup = vehicle, endpoint, speedup
        self._link = GroundLink(vehicle, endpoint)
        self._running = True

    def run(self) -> None:
        """Fly until SIGTERM or SIGINT; the log is complete afterwards."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda _number, _frame: self._stop())
        try:
            while self._running and not self._link.heard:
                select.select(self._endpoint.sockets(), [], [], _WAIT_S)
                self._link.poll()
            began = time.monotonic()
            flown = 0.0
            while self._running:
                self._slice()
                flown += SLICE / LOOP_HZ
                ahead = flown / self._speedup - (time.monotonic() - began) if self._speedup > 0.0 else 0.0
                if ahead > 0.0:
                    time.sleep(ahead)
                elif ahead < -_BEHIND_S:
                    began -= ahead
        finally:
            self._vehicle.close()
            self._endpoint.close()

    def _slice(self) -> None:
        for _ in range(SLICE):
            self._vehicle.loop()
            self._link.send_due()
        self._link.poll()

    def _stop(self) -> None:
        self._running = False
