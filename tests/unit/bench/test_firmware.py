"""The sensor source and the scoring of ``bench.firmware``, without a firmware."""

from __future__ import annotations

import numpy as np
import pytest

from bench.firmware.__main__ import main
from bench.firmware.arducopter import simulated
from bench.firmware.px4 import sensors
from bench.firmware.px4_source import RATE_HZ, Board
from bench.firmware.scoring import Row, table
from bench.firmware.truth import MGAUSS, drawn


def board(seed: int = 3) -> Board:
    truth = sensors(drawn(seed, 1, 1))
    for kind in ("accel", "gyro", "mag"):
        truth[kind][0]["noise"] = 0.0
    return Board(truth, seed)


def test_the_true_parameters_put_px4s_readings_right() -> None:
    truth = drawn(3, 1, 1)
    right = truth.parameters("px4")
    held = board()
    held.request({"do": "hold", "pose": [90.0, 0.0, 0.0], "dps": 90.0})
    while held.request({"do": "state"})["moving"]:
        held.step(1.0 / RATE_HZ)
    reading = held.read("accel", 0)
    assert reading is not None
    offset = np.array([right[f"CAL_ACC0_{axis}OFF"] for axis in "XYZ"])
    scale = np.array([right[f"CAL_ACC0_{axis}SCALE"] for axis in "XYZ"])
    np.testing.assert_allclose((reading - offset) * scale, [0.0, -9.80665, 0.0], atol=1e-9)


def test_a_compass_reads_the_field_with_the_true_parameters() -> None:
    right = drawn(3, 1, 1).parameters("px4")
    reading = board().read("mag", 0)
    assert reading is not None
    offset = np.array([right[f"CAL_MAG0_{axis}OFF"] for axis in "XYZ"])
    x, y, z = (right[f"CAL_MAG0_{axis}SCALE"] for axis in "XYZ")
    xy, xz, yz = (right[f"CAL_MAG0_{axis}ODIAG"] for axis in "XYZ")
    matrix = np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])
    np.testing.assert_allclose(matrix @ (reading - offset), [0.2123, 0.0113, 0.4268], atol=1e-9)


def test_a_warm_up_ends_at_its_temperature() -> None:
    warmed = board()
    warmed.request({"do": "warm_up", "start": 10.0, "end": 60.0, "tau_s": 1.0})
    for _ in range(int(20 * RATE_HZ)):
        warmed.step(1.0 / RATE_HZ)
    assert warmed.celsius == pytest.approx(60.0, abs=0.01)


def test_arducopters_simulator_gets_the_errors_of_the_truth() -> None:
    truth = drawn(4, 2, 1)
    found = simulated(truth, 3.0)
    assert found["SIM_ACC2_BIAS_Y"] == truth.units[1].accel_offset[1]
    assert found["SIM_MAG1_OFS_Z"] == truth.compasses[0].added[2] / MGAUSS


def test_a_sentence_that_is_untrue_makes_a_step_bad() -> None:
    good = Row("px4", "factory", "gyro", "succeeded", "full", (0.5, -2.5), "CAL_GYRO0_XOFF -2.5", 9.0, (), "done")
    bad = Row("px4", "factory", "accel", "succeeded", "full", (), "", 9.0, ("it holds 0",), "done")
    assert good.good
    assert not bad.good
    assert "1 of 2 intervals hold the truth; 1 of 2 steps" in table([good, bad])


def test_without_a_firmware_there_is_nothing_to_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "nothing to run" in capsys.readouterr().out
