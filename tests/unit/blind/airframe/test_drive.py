from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.blind.airframe.draw import draw_vehicle, without_battery
from mavcal.calib.blind.airframe.drive import Drives, Supply
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.vehicle import Vehicle

DT = 1.0 / 1200.0


def vehicle(**changes: float) -> Vehicle:
    drawn = draw_vehicle(np.random.default_rng(5))
    plain = {"filter": 0.0, "delay": 0.0, "expo": 1.0, "slew": math.inf}
    return replace(drawn, drive=replace(drawn.drive, **{**plain, **changes}))


def after(v: Vehicle, seconds: float, command: float, start: Drives | None = None) -> float:
    drives = start or Drives(v, DT)
    for _ in range(round(seconds / DT)):
        drives.step([command] * len(v.rotors), 1.0)
    return drives.speeds[0]


def test_a_motor_answers_with_its_time_constants():
    v = vehicle(up=0.03, down=0.06)
    assert after(v, 0.03, 1.0) == pytest.approx(v.drive.top * (1.0 - math.exp(-1.0)), rel=1e-6)
    drives = Drives(v, DT)
    after(v, 2.0, 1.0, drives)
    assert after(v, 0.06, 0.0, drives) == pytest.approx(v.drive.top * math.exp(-1.0), rel=1e-6)


def test_nothing_happens_before_the_delay_is_over():
    v = vehicle(delay=0.02)
    assert after(v, 0.02, 1.0) == 0.0
    assert after(v, 0.02 + DT, 1.0) > 0.0


def test_a_slew_limit_makes_a_ramp():
    v = vehicle(slew=2.0, up=1e-4, down=1e-4)
    assert after(v, 0.25, 1.0) == pytest.approx(0.5 * v.drive.top, rel=1e-6)  # expo 1: speed as the command


@pytest.mark.parametrize("command", [0.2, 0.5, 0.9])
def test_static_thrust_follows_the_curve(command):
    v = vehicle(expo=0.6)
    share = (after(v, 3.0, command) / v.drive.top) ** 2
    assert share == pytest.approx(0.4 * command + 0.6 * command**2)
    a = 0.6
    electric = vehicle(back_emf=a)
    speed = after(electric, 3.0, command) / v.drive.top
    assert a * speed + (1.0 - a) * speed**2 == pytest.approx(command)  # voltage = back-EMF + load


def test_thrust_follows_the_voltage_with_its_exponent():
    v = vehicle(exponent=1.6)
    drives = Drives(v, DT)
    for _ in range(2400):
        drives.step([1.0] * len(v.rotors), 0.9)
    assert (drives.speeds[0] / v.drive.top) ** 2 == pytest.approx(0.9**1.6)


def test_a_dead_band_holds_small_changes():
    drives = Drives(vehicle(), DT, band=0.05)
    for command in (0.50, 0.54, 0.46):
        for _ in range(1200):
            drives.step([command] * 4, 1.0)
        assert drives.speeds[0] == pytest.approx(0.5 * vehicle().drive.top)


def test_the_battery_gives_what_the_rotors_take():
    v = vehicle()
    forces = Forces(v)
    speeds = [0.7 * v.drive.top] * len(v.rotors)
    supply = Supply(v, forces)
    for _ in range(400):
        supply.step(speeds, 0.01)
    battery = v.battery
    torque = v.propeller.torque_arm * v.propeller.thrust * speeds[0] ** 2
    assert supply.voltage * supply.current * battery.efficiency == pytest.approx(
        len(speeds) * torque * speeds[0], rel=1e-4
    )
    assert supply.voltage == pytest.approx(
        battery.full - battery.fall * supply.drawn / battery.capacity - battery.resistance * supply.current, rel=1e-6
    )
    steady = Supply(without_battery(v), forces)
    steady.step(speeds, 10.0)
    assert steady.ratio == 1.0
