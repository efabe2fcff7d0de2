"""The page of a log's health."""

from __future__ import annotations

import dataclasses

from mavcal.calib.health.page import health_page
from mavcal.calib.health.report import health
from tests.unit.health.faults import FAULTS, injected
from tests.unit.health.made import flight


def test_the_page_says_the_verdict_first_and_asks_nobody_else():
    recording = injected(flight(1), FAULTS[0], 0)
    page = health_page(health(recording), recording, title="<made & bad>")
    assert "&lt;made &amp; bad&gt;" in page
    assert page.index("accelerometer 1 (") < page.index("Every sensor")
    assert "Limits 0.25 and 0.75 m/s\u00b2" in page
    assert page.count("<svg") == 10  # six sensors, two thermometers, the throttle and VIBE
    assert "http" not in page.replace('http-equiv="Content-Security-Policy"', "").replace(
        "http://www.w3.org/2000/svg", ""
    )
    assert "<script" not in page


def test_a_healthy_log_has_a_page_without_a_fault():
    recording = dataclasses.replace(flight(2), source="fine.bin")
    page = health_page(health(recording), recording, title="fine")
    assert "6 of 6 sensors ok." in page
    assert "faulty:" not in page
