"""`python -m mavcal.service.simvehicle`: a simulated vehicle in a process of its own."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace

from mavcal.service.simvehicle.config import SimAutopilot, VehicleConfig, load_config
from mavcal.service.simvehicle.errors import SimulatedVehicleError
from mavcal.service.simvehicle.links import SerialPort, SimEndpoint, TcpServer, UdpIn, UdpOut
from mavcal.service.simvehicle.parameters import load_table
from mavcal.service.simvehicle.scripts import SCRIPTS
from mavcal.service.simvehicle.server import SimServer, make_vehicle


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="python -m mavcal.service.simvehicle", description=__doc__)
    p.add_argument("--autopilot", choices=[str(a) for a in SimAutopilot], help="which firmware it is")
    p.add_argument("--udpout", metavar="HOST:PORT", action="append", default=[], help="send to a ground station")
    p.add_argument("--udpin", metavar="HOST:PORT", action="append", default=[], help="listen for ground stations")
    p.add_argument("--tcp", metavar="HOST:PORT", action="append", default=[], help="serve one TCP client at a time")
    p.add_argument("--serial", action="store_true", help="a serial port: a pseudo-terminal, whose name is said")
    p.add_argument("--seed", type=int, metavar="NUMBER", help="of its errors and its noise")
    p.add_argument("--speed", type=float, default=1.0, metavar="FACTOR", help="vehicle seconds per wall second")
    p.add_argument("--system-id", type=int, metavar="NUMBER", help="its MAVLink system, 1 to 255")
    p.add_argument("--control", type=int, default=0, metavar="PORT", help="control channel (0: any free port)")
    p.add_argument("--config", default=None, metavar="JSON|FILE", help="an object of configuration entries")
    p.add_argument("--params", default=None, metavar="FILE", help="parameter table: name,value,type a line")
    p.add_argument("--script", choices=list(SCRIPTS), help="movements that it makes by itself")
    p.add_argument("--sitl", action="store_true", help="PX4: behave as the simulator build (no reboot, no TC_* module)")
    p.add_argument("--follow-stdin", action="store_true", help="exit when stdin ends")
    return p


def described(of: argparse.ArgumentParser | None = None) -> list[tuple[str, str]]:
    """Each option with its values, and what it is for; of the other vehicle's command line where `of` is given."""
    found = []
    for action in (of or parser())._actions:
        if action.dest == "help":
            continue
        values = f"[{'|'.join(action.choices)}]" if action.choices else action.metavar or ""
        text = f"{(action.help or '')[:1].upper()}{(action.help or '')[1:]}"
        repeated = "; repeated" if isinstance(action.default, list) else ""
        found.append((f"{action.option_strings[0]} {values}".strip(), f"{text}{repeated}."))
    return found


def _config(args: argparse.Namespace) -> VehicleConfig:
    config = load_config(args.config)
    if args.autopilot is not None:
        config = replace(config, autopilot=SimAutopilot(args.autopilot))
    if args.seed is not None:
        config = replace(config, seed=args.seed)
    if args.system_id is not None:
        config = load_config({"system_id": args.system_id}, config)
    return replace(config, sitl=True) if args.sitl else config


def _links(args: argparse.Namespace, config: VehicleConfig) -> list[SimEndpoint]:
    links: list[SimEndpoint] = [UdpOut(a) for a in args.udpout]
    links += [UdpIn(a, first_for_ever=config.autopilot is SimAutopilot.PX4) for a in args.udpin]
    links += [TcpServer(a) for a in args.tcp]
    links += [SerialPort()] if args.serial else []
    return links or [UdpOut("127.0.0.1:14550")]


def _server(args: argparse.Namespace) -> SimServer:
    config = _config(args)
    vehicle = make_vehicle(config)
    if args.params:
        vehicle.load_parameters(load_table(args.params))
    vehicle.preset_parameters(config.parameters)
    server = SimServer(vehicle, _links(args, config), args.control, args.speed)
    if args.script:
        server.run_script(args.script)
    return server


def main(argv: Sequence[str] | None = None) -> int:
    """Run until SIGTERM, `shutdown`, or the end of stdin. Exit code 2: wrong use."""
    args = parser().parse_args(argv)
    try:
        server = _server(args)
    except SimulatedVehicleError as error:
        print(f"simvehicle: {error}", file=sys.stderr)  # noqa: T201 - the command line's own voice
        return 2
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: server.stop())
    ready = {
        "ready": True,
        "url": server.links[0].url,
        "urls": [link.url for link in server.links],
        "control": server.control.address,
        "seed": server.vehicle.config.seed,
    }
    print(json.dumps(ready), flush=True)  # noqa: T201
    server.run(follow_stdin=args.follow_stdin)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
