"""The room of a diagnosis whose report is of airframe and air, at a desk and on a phone."""

from __future__ import annotations

import json

import pytest
from playwright.sync_api import expect

from mavcal.calib.gap.schema import as_json
from mavcal.calib.gap_report import gap_to_html, verdict_sentence
from mavcal.service.computations import PAGE, REPORT
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.uploads import GAP
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobDocument
from tests.unit.gap_report.flown import drag_flight, weak_motor, windy_null

from .panel import HAND, Panel, service, shot

DESK = {"width": 1280, "height": 800}
FLIGHTS = {"weak": weak_motor(), "drag": drag_flight(), "windy": windy_null()}
BACKGROUND = {"light": "rgb(255, 255, 255)", "dark": "rgb(18, 24, 30)"}
"""Of the report's page, which goes with the panel around it where that follows the system."""
SAID = {"weak": "Motor 3 is 7.9 % weak", "drag": "1.60 times the rotor drag", "windy": "Wind of 4.1 m/s from 75 deg"}


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """A service that has made these diagnoses: its address."""
    folder = tmp_path_factory.mktemp("diagnosed")
    store = SqliteStore(folder / "data")
    for name, report in FLIGHTS.items():
        store.save_job(row_from_job(_job(name, verdict_sentence(report, listed=False))))
        page = gap_to_html(report, title=f"Sim-to-real gap of {name}.bin")
        store.save_document(name, JobDocument(PAGE, "text/html", page.encode()))
        store.save_document(name, JobDocument(REPORT, "application/json", json.dumps(as_json(report)).encode()))
    store.close()
    with service(folder) as url:
        yield url


def _job(name: str, said: str) -> Job:
    return Job(
        id=name, vehicle_id=None, kind=GAP, state=JobState.SUCCEEDED, created_at=1.0, updated_at=2.0,
        options={"real": f"{name}.bin", "sim": "sim.bin", "nominal": []}, outcome=Result(said),
        context={"documents": [REPORT, PAGE]},
    )  # fmt: skip


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESK, HAND], ids=["desk", "hand"])
def test_the_room_shows_what_flew_differently(browser, diagnosed, size, theme):
    panel = Panel(browser, size)
    panel.page.emulate_media(color_scheme=theme)
    for name, report in FLIGHTS.items():
        panel.open(diagnosed, f"#/gap/{name}")
        panel.sees(verdict_sentence(report, listed=False), inside=".first-line")
        frame = panel.page.frame_locator("iframe.report")
        expect(frame.locator(".effect h3").first).to_contain_text(SAID[name])
        assert panel.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        held = panel.page.frames[1]
        assert held.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
        assert held.evaluate("getComputedStyle(document.body).backgroundColor") == BACKGROUND[theme]
        shot(panel, f"gap-{name}-{'phone' if size is HAND else 'desk'}-{theme}")
    assert panel.complaints == []
    panel.close()
