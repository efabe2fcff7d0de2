"""Calibrations of firmwares that somebody has built; MAVCAL_ARDUCOPTER and MAVCAL_PX4 name them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bench.firmware.__main__ import main

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]


@pytest.mark.parametrize(("option", "variable"), [("--arducopter", "MAVCAL_ARDUCOPTER"), ("--px4", "MAVCAL_PX4")])
def test_gyroscopes_and_accelerometers_are_calibrated_and_stay(tmp_path: Path, option: str, variable: str) -> None:
    binary = os.environ.get(variable)
    if not binary:
        pytest.skip(f"{variable} names no firmware")
    assert main([option, binary, "--only", "gyro", "--only", "accel", "--keep", str(tmp_path / "kept")]) == 0
