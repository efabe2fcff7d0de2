"""Two flights of one simulator: nothing is wrong with either, and nothing is to be said of the difference."""

from __future__ import annotations

import pytest

from mavcal.calib import gap, logs
from mavcal.calib.gap.schema import GapVerdict

pytestmark = [pytest.mark.shared, pytest.mark.long]

FLIGHTS = ("00000005.BIN", "00000010.BIN")


@pytest.mark.parametrize(("real", "sim"), [FLIGHTS, FLIGHTS[::-1]])
def test_two_flights_at_25_hz_show_no_gap(shared_data, real, sim):
    folder = shared_data / "sitl_baseline"
    report = gap.run(logs.read(folder / real), logs.read(folder / sim), nested=False)
    assert report.verdict is GapVerdict.NO_GAP
