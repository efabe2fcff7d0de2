"""``--all``: every vehicle that is heard on a link, for status, calibrate, preflight and revert."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from mavcal.service.commands.calibrate import HANDS_FREE
from mavcal.service.commands.preflight import FIXABLE
from mavcal.service.simvehicle import SimulatedVehicle

from .cli_bench import mavcal

pytestmark = pytest.mark.timeout(600)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
    return port


def test_what_needs_no_hands_is_the_same_everywhere() -> None:
    assert HANDS_FREE == FIXABLE


def test_whom_it_is_about_has_to_be_said(tmp_path: Path) -> None:
    folder = ("--data-dir", str(tmp_path))
    assert mavcal("status", *folder)[0] == 2
    assert mavcal("status", "--all", *folder)[0] == 2  # no link is remembered
    assert mavcal("revert", *folder)[0] == 2
    assert mavcal("calibrate", "accel", "--all", "--apply", *folder)[0] == 2


@pytest.mark.long
def test_two_vehicles_on_one_port(tmp_path: Path) -> None:
    link = f"udpout:127.0.0.1:{free_port()}"
    config = {"calibration": "fresh", "imu_count": 1, "parameters": {"INS_GYR_CAL": 0}}
    with (
        SimulatedVehicle("ardupilot", seed=8, speed=4.0, system_id=1, link=link, config=config) as one,
        SimulatedVehicle("ardupilot", seed=9, speed=4.0, system_id=2, link=link, config=config) as two,
    ):
        whom = ("--all", "--connect", one.url, "--data-dir", str(tmp_path))
        code, told, said = mavcal("status", *whom)
        assert (code, sorted(v["system"] for v in told["vehicles"])) == (0, [1, 2]), said
        for sim in (one, two):
            sim.call("add", sensor="gyro", instance=0, by=[0.02, 0.0, 0.0])
        before = [sim.parameters()[0]["INS_GYROFFS_X"] for sim in (one, two)]
        code, told, said = mavcal("calibrate", "gyro", "--apply", *whom)
        assert (code, [v["state"] for v in told["vehicles"]]) == (0, ["succeeded"] * 2), (told, said)
        assert all("would arm now" in v["readiness"]["text"] for v in told["vehicles"]), told
        assert [sim.parameters()[0]["INS_GYROFFS_X"] for sim in (one, two)] != before
        code, told, said = mavcal("preflight", *whom)
        assert len(told["vehicles"]) == 2, said
        assert all(c["verdict"] != "fail" for v in told["vehicles"] for c in v["checks"]), told
        code, told, said = mavcal("revert", *whom)
        assert (code, [[j["state"] for j in v["jobs"]] for v in told["vehicles"]]) == (0, [["reverted"]] * 2), (
            told,
            said,
        )
        assert [sim.parameters()[0]["INS_GYROFFS_X"] for sim in (one, two)] == before
