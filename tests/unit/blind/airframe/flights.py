"""Short flights in calm air."""

from __future__ import annotations

import numpy as np

from mavcal.calib.blind.airframe.air import Weather
from mavcal.calib.blind.airframe.draw import draw_vehicle
from mavcal.calib.blind.airframe.flight import LOOP_HZ, Errors, Flown, fly
from mavcal.calib.blind.airframe.logs import draw_units
from mavcal.calib.blind.airframe.mission import Leg, LegKind, Mission
from mavcal.calib.blind.airframe.pilot import tuned
from mavcal.calib.blind.airframe.sides import Pair, Side
from mavcal.calib.blind.airframe.vehicle import Vehicle

SHORT = Mission(
    (
        Leg(LegKind.REST, 1.0),
        Leg(LegKind.TAKE_OFF, 8.0, height=3.5),
        Leg(LegKind.FLY, 4.0),
        Leg(LegKind.FLY, 3.5, (6.0, 0.0, 0.0)),
        Leg(LegKind.FLY, 3.0),
        Leg(LegKind.LAND, 15.0),
        Leg(LegKind.REST, 1.0),
    ),
    heading=0.6,
)


def no_errors(count: int, cutoff: float = 40.0) -> Errors:
    zero = np.zeros((count, 3))
    return Errors(velocity=zero, attitude=zero, gyro=zero, height=np.zeros(count), cutoff=cutoff)


def flown_in_calm(vehicle: Vehicle, mission: Mission = SHORT, events=None) -> Flown:
    count = round(mission.longest * LOOP_HZ) + 1
    tuning = tuned([vehicle], vehicle.drive.expo, 0.0, compensates=True)
    return fly(vehicle, tuning, mission, np.zeros((count, 3)), no_errors(count), events)


def calm_pair(seed: int) -> Pair:
    rng = np.random.default_rng(seed)
    vehicle, calm = draw_vehicle(rng), Weather(0.0, 0.0, 0.0)
    side = Side(vehicle, calm, draw_units(rng))
    return Pair(side, side)
