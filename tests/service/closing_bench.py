"""What the tests of the loop share: flights of the flying vehicle, a short mission, and a diagnosis of two numbers.

The diagnosis here is none: it compares the throttle of hovering, which is what thrust scale is about, and says so in a
report of the real form. That of the command is `mavcal.calib.gap.run`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib.airframe.answer import AirframePart, Domain, Quantity, Rollout
from mavcal.calib.gap.schema import (
    EffectEstimate,
    EffectEvidence,
    GapReport,
    GapVerdict,
    Inputs,
    MultipleTesting,
    ParameterEstimate,
    Shrink,
)
from mavcal.calib.logs.missions.course import Place, with_take_off
from mavcal.calib.logs.missions.items import LoggedMission, MissionItem
from mavcal.calib.recording import Recording, Sensor
from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.follower import Follower
from mavcal.service.closing.link import VehicleLink
from mavcal.service.closing.loop import ClosingPlan
from mavcal.service.closing.mission import Leg, LogMission, Mission
from mavcal.service.closing.pilot import Pilot
from mavcal.service.closing.settings import SimSettings
from mavcal.service.closing.simulator import Simulator, SimulatorCommand, free_port
from mavcal.service.link.endpoint import parse_endpoint

ROOT = Path(__file__).resolve().parents[2]
FLYING = (
    f"env PYTHONPATH={ROOT} {sys.executable} -m mavcal simulate flight "
    "--params {params} --frame {frame} --log {log} --port {port} --speedup {speedup}"
)
SHORT = Mission((Leg("hover", 4.0), Leg("out", 1.0, ahead=2.0), Leg("descent", 5.0, down=1.0, until_height=1.0)),
                rest_s=1.0, height=3.0, rest_after_s=1.0)  # fmt: skip
FIELD = Place(47.0, 8.0, 400.0)
"""Home of a mission far from that of the simulator."""
SAME = 0.005
"""Ratio of hover throttles that is none."""


def hover(recording: Recording) -> float:
    """Throttle of the calmest half of the flight."""
    throttle = recording.channel(Sensor.THROTTLE)
    flying = throttle.values[throttle.values[:, 0] > 0.15, 0]
    return float(np.median(flying))


def compare(real: Recording, sim: Recording, *, frame: Mapping[str, Any], folder: Path, on_progress: Any) -> GapReport:
    """A report that names `thrust_scale` where the hover throttles differ."""
    on_progress("comparing", 0.5, 1.0)
    ratio = hover(sim) / hover(real)
    error = 9.80665 * abs(ratio - 1.0)
    effects: tuple[EffectEstimate, ...] = ()
    if abs(ratio - 1.0) > SAME:
        patch = {"frame_json": {"hoverThrOut": frame.get("hoverThrOut", 0.39) / ratio}}
        scale = ParameterEstimate("s", ratio - 1.0, 0.001, (ratio - 1.002, ratio - 0.998), "1", ratio=ratio)
        evidence = EffectEvidence(500.0, 1, 1e-9, 0.99, 1.0)
        effects = (
            EffectEstimate("thrust_scale", None, (), (scale,), evidence, sim_patch=patch, domain=Domain.AIRFRAME),
        )
    inputs = Inputs(None, None, 10.0, 60.0, "none", 0.0, "throttles", {}, "")
    predicted = Rollout(1.0, Quantity.VELOCITY, "m/s", error, 0.01, 0.0, None, None)
    return GapReport(
        inputs,
        GapVerdict.EXPLAINED if effects else GapVerdict.NO_GAP,
        effects=effects,
        shrink=Shrink(1.0, 0.02, 0.0, "noise", 0.98, (0.95, 1.0), nested=False) if effects else None,
        multiple_testing=MultipleTesting(1, 0.005),
        airframe=AirframePart(rollout=(predicted,)),
    )


def waypoints() -> LogMission:
    """Up, 12 m north, 3 s there, back and down; from a field elsewhere."""
    latitude, longitude = FIELD.at(12.0, 0.0)
    home = MissionItem(0, 16, 0, latitude=FIELD.latitude, longitude=FIELD.longitude, altitude=FIELD.altitude)
    wait = MissionItem(1, 19, 3, (3.0, 0.0, 0.0, 0.0), latitude, longitude, 4.0)
    back = MissionItem(2, 16, 0, (0.0,) * 4, FIELD.latitude, FIELD.longitude, FIELD.altitude + 4.0)
    land = MissionItem(3, 21, 3)
    return LogMission(with_take_off(LoggedMission(home, (wait, back, land))), rest_s=1.0, rest_after_s=1.0)


def fly(folder: Path, settings: SimSettings, mission: Mission | LogMission = SHORT) -> Path:
    """A flight of its own with `settings`, and its log."""
    folder.mkdir(parents=True, exist_ok=True)
    settings.write(folder / "sim.parm", folder / "frame.json")
    port = free_port()
    arguments = SimulatorCommand(FLYING).arguments(port=port, speedup=0.0, here=ROOT)
    with Simulator(arguments, folder) as simulator, VehicleLink(parse_endpoint(f"tcp:127.0.0.1:{port}")) as link:
        link.connect(30.0, simulator.check)
        vehicle = Conversation(link, simulator.check, lambda *_: None)
        (Follower(vehicle, mission) if isinstance(mission, LogMission) else Pilot(vehicle, mission)).fly()
    return folder / "log.bin"


def plan(real: Recording, work: Path, command: str = FLYING, **other: Any) -> ClosingPlan:
    given = {"speedup": 0.0, "mission": SHORT, "heartbeat_s": 30.0, **other}
    return ClosingPlan(real, "0" * 64, SimulatorCommand(command), work, ROOT, **given)
