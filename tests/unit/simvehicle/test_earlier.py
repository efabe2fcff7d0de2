"""A simulated vehicle starts with an older calibration in force, unless it is told to be a new board."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.earlier import earlier_calibration
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import FlightController

NEUTRAL_ONE = re.compile(r"SCAL|SCALE|DIA_|DIA2|DIA3")


def vehicle(autopilot: str, **config: object) -> FlightController:
    return make_vehicle(load_config({"autopilot": autopilot} | config))


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("seed", [1, 7])
def test_nothing_that_corrects_a_sensor_is_neutral(autopilot: str, seed: int) -> None:
    started = vehicle(autopilot, seed=seed)
    values = earlier_calibration(started.config, started.world.truth)
    assert len(values) == (55 if autopilot == "ardupilot" else 47)
    for name, value in values.items():
        neutral = 1.0 if NEUTRAL_ONE.search(name) else 0.0
        assert abs(value - neutral) > 1e-5, name
        assert started.table.get(name) == pytest.approx(value, rel=1e-6), name


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_an_accelerometer_of_a_started_vehicle_reads_nearly_gravity(autopilot: str) -> None:
    for seed in range(20):
        started = vehicle(autopilot, seed=seed, thermal=False)
        values = earlier_calibration(started.config, started.world.truth)
        for k, truth in enumerate(started.world.truth.accels):
            base = (f"INS_ACC{'' if k == 0 else k + 1}OFFS", f"INS_ACC{'' if k == 0 else k + 1}SCAL")
            names = [[f"{b}_{a}" for a in "XYZ"] for b in base]
            if autopilot == "px4":
                names = [[f"CAL_ACC{k}_{a}{q}" for a in "XYZ"] for q in ("OFF", "SCALE")]
            offset, scale = ([values[n] for n in row] for row in names)
            raw = truth.distort(np.array([[0.0, 0.0, -9.80665]]))[0]
            off = abs(np.linalg.norm((raw - offset) * scale) - 9.80665)
            assert 0.0 < off < 0.25


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_new_board_is_neutral(autopilot: str) -> None:
    new = vehicle(autopilot, calibration="none")
    for name in earlier_calibration(new.config, new.world.truth):
        if "CALTEMP" not in name:
            assert new.table.get(name) in (0.0, 1.0), name


def test_an_unknown_calibration_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="calibration"):
        load_config({"calibration": "perfect"})
