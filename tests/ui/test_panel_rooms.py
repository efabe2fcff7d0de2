"""What a person sees when nothing runs yet, and what is said when something is wrong."""

from __future__ import annotations

import json

import numpy as np
import pytest
from playwright.sync_api import expect

from mavcal.service.api.security import digest

from .panel import PHONE, Panel, service, sim, until

pytestmark = pytest.mark.timeout(300)


def test_home_says_what_each_sensor_needs_and_asks_nobody_else(desk, tmp_path):
    with service(tmp_path, "--connect", sim()) as url:
        desk.open(url)
        desk.sees("Live", inside=".connection")
        desk.sees("Nothing was calibrated here yet", inside=".vehicle-card")
        tiles = desk.page.locator(".tile")
        until(lambda: tiles.count() == 4, 20, "four tiles")
        for name in ("Gyro", "Accelerometer", "Compass", "Temperature"):
            expect(desk.calibrate(name)).to_be_enabled()
        assert "not calibrated here" in desk.text(".tile")  # a color never says it alone
        desk.sees("A simulated vehicle is connected", inside=".banner")
        assert all(asked.startswith((url, "data:", "blob:")) for asked in desk.asked), desk.asked
        assert desk.complaints == []


@pytest.mark.long
def test_nothing_is_wider_than_a_phone_in_any_theme(browser, tmp_path):
    panel = Panel(browser, PHONE)
    with service(tmp_path, "--connect", sim("px4")) as url:
        panel.open(url)
        for theme in ("light", "dark", "sunlight"):
            panel.page.evaluate("name => localStorage.setItem('mavcal-theme', name)", theme)
            for place in ("", "#/logs", "#/gap", "#/setup"):
                panel.open(url, place)
                panel.page.reload()
                panel.sees("mavcal", inside=".top")
                assert panel.page.evaluate("document.documentElement.dataset.theme") == theme
                assert panel.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    panel.close()


@pytest.mark.long
def test_links_are_opened_refused_and_closed_and_text_stays_text(desk, tmp_path):
    with service(tmp_path) as url:
        desk.open(url, "#/setup")
        desk.sees("No connection is open")
        desk.page.fill("#url", "ftp:nowhere")
        desk.press("Connect")
        desk.sees("Known forms", inside=".notice")
        desk.page.fill("#url", "serial:/dev/<img src=x onerror=document.title='hurt'>:57600")
        desk.press("Connect")
        desk.sees("<img src=x", inside=".notice")
        assert desk.page.locator("#panel img").count() == 0
        assert desk.page.title() == "Setup · mavcal"
        desk.page.fill("#url", "serial:/dev/ttyNONE9:57600")
        desk.press("Connect")
        desk.sees("ttyNONE9", inside=".jobs")
        desk.press("Close serial:/dev/ttyNONE9:57600")
        desk.sees("No connection is open")


@pytest.mark.long
def test_with_keys_the_panel_asks_for_one_and_again_when_it_is_wrong(desk, tmp_path):
    keys = [{"name": "crew", "sha256": digest("open sesame"), "scopes": ["admin"]}]
    with service(tmp_path, MAVCAL_API_KEYS=json.dumps(keys)) as url:
        desk.open(url)
        desk.sees("This service asks for an API key")
        desk.page.fill("#key", "wrong")
        desk.press("Use this key")
        desk.sees("No key", inside=".connection")
        desk.page.fill("#key", "open sesame")
        desk.press("Use this key")
        desk.sees("No vehicle has been heard yet")
        desk.sees("Live", inside=".connection")


@pytest.mark.long
def test_a_service_that_goes_is_told_and_comes_back_by_itself(desk, tmp_path):
    with service(tmp_path) as url:
        desk.open(url)
        desk.sees("Live", inside=".connection")
    until(lambda: "Live" not in desk.text(".connection"), 30, "the page says that the service has gone")
    port = int(url.rsplit(":", 1)[1].strip("/"))
    with service(tmp_path, port=port):
        desk.sees("Live", inside=".connection")


@pytest.mark.long
def test_a_log_is_dropped_drawn_and_fitted(desk, tmp_path):
    path = tmp_path / "rest.csv"
    rows = np.column_stack([np.arange(2000) / 100, *np.random.default_rng(1).normal(0.0, 0.01, (3, 2000))])
    np.savetxt(path, rows, delimiter=",", header="t,gyro_x,gyro_y,gyro_z", comments="")
    with service(tmp_path) as url:
        desk.open(url, "#/logs")
        desk.page.set_input_files("input[type=file]", str(path))
        desk.sees("rest.csv", inside="h1")
        desk.sees("Gyro 1", inside=".charts")
        desk.page.select_option("#method", "gyro-rest")
        desk.press("Fit gyro-rest")
        desk.wait_for_state("Done", 60)
        assert desk.complaints == []


@pytest.mark.long
def test_a_broken_log_is_refused_in_one_sentence(desk, tmp_path):
    path = tmp_path / "broken.bin"
    path.write_bytes(bytes(range(256)) * 8)
    with service(tmp_path) as url:
        desk.open(url, "#/logs")
        desk.page.set_input_files("input[type=file]", str(path))
        desk.sees("broken.bin", inside=".notice")
        assert desk.page.locator(".drop").count() == 1  # the next one can be dropped


@pytest.mark.long
def test_the_documentation_is_drawn_from_local_files_under_the_policy(desk, tmp_path):
    with service(tmp_path) as url:
        desk.open(f"{url}docs")
        desk.sees("/healthz", inside="#interface")
        assert all(asked.startswith((url, "data:", "blob:")) for asked in desk.asked)
        assert desk.complaints == []


@pytest.mark.long
def test_without_the_libraries_the_panel_draws_by_itself(browser, tmp_path):
    panel = Panel(browser)
    panel.page.route("**/vendor/**", lambda route: route.abort())
    with service(tmp_path, "--connect", sim(config={"parameters": {"INS_GYR_CAL": 0}})) as url:
        panel.open(url)
        panel.calibrate("Accelerometer").click()
        panel.page.wait_for_selector("attitude-scene canvas", state="attached")
        painted = """() => { const c = document.querySelector('.stage attitude-scene canvas');
            const pen = c && c.getContext('2d');
            return !!pen && c.width > 0 && pen.getImageData(0, 0, c.width, c.height).data.some(v => v > 0); }"""
        until(lambda: bool(panel.page.evaluate(painted)), 30, "the vehicle is drawn without three.js")
        panel.press("Cancel")
        panel.press("Stop it")
        panel.wait_for_state("Cancelled", 30)
    panel.close()


@pytest.mark.long
def test_what_is_loaded_before_a_picture_is_small(desk, tmp_path):
    sizes: list[int] = []
    desk.page.on("response", lambda r: sizes.append(len(r.body())) if "/panel/" in r.url else None)
    with service(tmp_path) as url:
        desk.open(url)
        desk.sees("No vehicle has been heard yet")
        assert not [asked for asked in desk.asked if "/web/vendor/" in asked or "/panel/vendor/" in asked]
        assert 0 < sum(sizes) <= 300_000
