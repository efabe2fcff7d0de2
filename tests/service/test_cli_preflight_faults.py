"""``mavcal preflight`` against both simulated autopilots, healthy and with each fault: the right check fails, alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .test_cli_preflight import preflight
from .test_preflight import FAULTS, looked_at, remember, reset, vehicle

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]


def found(sim: SimulatedVehicle, folder: Path) -> tuple[int, dict[str, Any]]:
    done = preflight(sim.url, folder, "--json")
    told: dict[str, Any] = json.loads(done.stdout)
    assert "checks" in told, (told, done.stderr)
    assert told["seconds"] < scaled(10.0)
    assert all(check["evidence"] for check in told["checks"]), told
    return done.returncode, told


def failed(told: dict[str, Any]) -> list[str]:
    return [check["id"] for check in told["checks"] if check["verdict"] == "fail"]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_the_right_check_fails_alone(autopilot: str, tmp_path: Path) -> None:
    with vehicle(autopilot) as sim:
        async with looked_at(tmp_path, sim) as life:
            await remember(life)
        sim.wait(10.0)
        code, told = found(sim, tmp_path)
        assert (code, told["verdict"]) == (0, "pass"), told
        for right, fault, mended in FAULTS:
            sim.call(**fault)
            sim.wait(1.0)
            code, told = found(sim, tmp_path)
            assert (code, failed(told)) == (1, [right.value]), (fault, told)
            sim.call(**mended)
            sim.wait(1.0)
        reset(sim)
        code, told = found(sim, tmp_path)
        assert (code, failed(told)) == (1, ["parameters_changed"]), told
    config = {"calibration": "fresh"} | ({"parameters": {"IMU_GYRO_CAL_EN": 0.0}} if autopilot == "px4" else {})
    with SimulatedVehicle(autopilot, seed=6, speed=2.0, config=config) as other:
        other.wait(10.0)
        code, told = found(other, tmp_path)
        assert (code, failed(told)) == (1, ["sensor_ids"]), told
