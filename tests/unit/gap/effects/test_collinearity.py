"""Which effects imitate each other on which mission: the table of the page, measured again."""

from __future__ import annotations

import re

import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor
from scripts.effects import PAGE

from .conftest import make
from .imitation import LEAST, MISSIONS, NONE, NOT_TESTABLE, closest


@pytest.mark.parametrize("mission", MISSIONS)
def test_the_page_says_who_imitates_whom(mission):
    page = PAGE.read_text(encoding="utf-8")
    column = MISSIONS.index(mission)
    rows = {
        (sensor, effect_id): cells.split("|")[column].strip()
        for sensor, effect_id, cells in re.findall(r"^\| (accel|gyro|mag) \| (\w+) \| (.*) \|$", page, flags=re.M)
    }
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        table = closest(sensor, mission)
        written = {effect_id: cell for (s, effect_id), cell in rows.items() if s == sensor and cell != NOT_TESTABLE}
        assert set(written) == set(table), "scripts/effects writes the table"
        for effect_id, (rival, kappa) in table.items():
            if written[effect_id] == NONE:
                assert kappa < LEAST + 0.015, effect_id
                continue
            name, number = written[effect_id].rsplit(" ", 1)
            assert float(number) == pytest.approx(kappa, abs=0.015), effect_id
            assert name == rival or kappa > 0.99, effect_id  # ties may fall either way


def test_a_tumble_separates_what_rest_cannot():
    static, tumble = closest(Sensor.ACCEL, "static"), closest(Sensor.ACCEL, "tumble")
    assert static["reference_attitude"][1] > 0.99
    assert tumble["accel_scale"][1] < 0.5
    assert by_id()["accel_scale"].missing(make(Sensor.ACCEL, "static")) is not None
