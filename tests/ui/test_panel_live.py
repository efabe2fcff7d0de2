"""The live room: a vehicle is asked for its samples while somebody looks; a simulated one is turned by hand."""

from __future__ import annotations

import json
import math

import httpx
import pytest
from playwright.sync_api import expect

from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .panel import PHONE, Panel, service, sim, until

pytestmark = pytest.mark.timeout(300)


def live(url: str) -> str:
    """The address of the live room of the first vehicle."""
    until(lambda: bool(found := vehicles(url)) and bool(found[0]["uid"]), 30, "a vehicle")
    return f"#/vehicle/{vehicles(url)[0]['id']}/live"


def vehicles(url: str) -> list[dict[str, object]]:
    return list(httpx.get(f"{url}api/v1/vehicles", timeout=scaled(20)).json())


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_live_room_has_the_vehicle_send_its_samples_and_says_so(browser, desk, tmp_path, autopilot):
    with service(tmp_path, "--connect", sim(autopilot, speed=1, hand="off")) as url:
        desk.open(url, live(url))
        desk.sees("Asked for 50 samples a second", 30, ".asked")
        until(lambda: desk.page.locator("strip-chart").count() >= 2, 30, "a chart for each accelerometer")
        until(
            lambda: any(f"{n} Hz" in desk.text("figcaption") for n in ("49", "50", "51", "49.9", "50.1")), 30, "50 Hz"
        )
        desk.sees("% lost", inside="figcaption")
        other = Panel(browser, PHONE)
        other.open(url, live(url))
        other.press("200 Hz")
        other.sees("Asked for 200 samples a second", 30, ".asked")
        desk.sees("Somebody else who watches asked for more", 30, ".asked")
        assert other.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        assert other.complaints == []
        other.close()
        desk.sees("Asked for 50 samples a second; put back when you leave", 30, ".asked")
        desk.page.evaluate("location.hash = '#/'")
        owed = tmp_path / "data" / "live-rates.json"
        until(lambda: owed.read_text() == "{}", 30, "the vehicle has its own rates again")
        assert desk.complaints == []


@pytest.mark.long
def test_the_live_room_says_why_a_vehicle_is_not_asked(desk, tmp_path):
    with service(tmp_path, "--read-only", "--connect", sim("px4", speed=1, hand="off")) as url:
        desk.open(url, live(url))
        desk.sees("The vehicle is not asked for samples: This service runs with --read-only", 30, ".asked")


@pytest.mark.long
def test_a_chart_keeps_every_peak_and_forgets_what_is_older_than_its_span(desk, tmp_path):
    with service(tmp_path) as url:
        desk.open(url)
        drawn = desk.page.evaluate("""async () => {
          const { Strip } = await import("./panel/chart/strip.js");
          const strip = new Strip(2, 60);
          for (let i = 0; i < 200 * 90; i += 1) {
            strip.push([i / 200], [[i === 200 * 70 + 7 ? 9 : Math.sin(i)], [i % 2 ? null : 1]]);
          }
          const chart = strip.chart(strip.end, ["x", "y"], "u");
          const slow = new Strip(1, 60);
          slow.push([1, 2, 3, 0.5, 1.5], [[1, 2, 3, 4, 5]]);
          return { points: chart.x.length, first: chart.x[0], peak: Math.max(...chart.lines[0].y),
            low: Math.min(...chart.lines[0].y), sorted: chart.x.every((v, i) => !i || v >= chart.x[i - 1]),
            other: [...new Set(chart.lines[1].y)], slow: slow.chart(1.5, ["x"], "u").lines[0].y };
        }""")
        assert 1190 <= drawn["points"] <= 1230
        assert drawn["peak"] == 9
        assert drawn["low"] < -0.99
        assert -61.2 <= drawn["first"] <= -59.8
        assert drawn["sorted"]
        assert drawn["other"] == [1]
        assert drawn["slow"] == [4]  # the clock has jumped back: what came before is of another start


def true_down(url: str) -> list[float]:
    """The world's down in the body of the simulated vehicle, as its stream has it."""
    samples = f"{url}api/v1/vehicles/{vehicles(url)[0]['id']}/samples"
    with httpx.stream("GET", samples, timeout=scaled(20)) as response:
        for line in response.iter_lines():
            data = json.loads(line.removeprefix("data: ")) if line.startswith("data: ") else {}
            if data.get("attitude"):
                w, x, y, z = data["attitude"]
                return [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    raise AssertionError("no attitude came")


def roll(down: list[float]) -> float:
    """Radians; a pitch beside it does not change it."""
    return math.atan2(down[1], down[2])


@pytest.mark.long
def test_the_mouse_and_the_arrow_keys_turn_a_simulated_vehicle(desk, tmp_path):
    with service(tmp_path, "--connect", sim("px4", speed=1)) as url:
        desk.open(url, live(url))
        scene = desk.page.locator("attitude-scene").first
        desk.sees("It follows the prompts by itself", inside=".banner")
        desk.press("I turn it")
        desk.sees("You turn it in its picture", inside=".banner")
        expect(scene).to_have_attribute("turnable", "")
        box = scene.bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        desk.page.mouse.move(x, y)
        desk.page.mouse.down()
        for step in range(1, 21):
            desk.page.mouse.move(x, y + 4 * step)
            desk.page.wait_for_timeout(30)
        desk.page.mouse.up()
        until(lambda: true_down(url)[2] < 0.8, 30, "0.8 rad of drag turn it by more than 36 deg")
        desk.page.wait_for_timeout(1500)
        before = roll(true_down(url))
        scene.focus()
        for _ in range(3):
            desk.page.keyboard.press("ArrowLeft")
        until(lambda: abs(roll(true_down(url)) - before) > 0.6, 30, "45 deg of roll")
        desk.press("It obeys by itself")
        expect(scene).not_to_have_attribute("turnable", "")
        assert desk.complaints == []


@pytest.mark.long
def test_the_poses_of_an_accelerometer_are_reached_by_hand(desk, tmp_path):
    with service(tmp_path, "--connect", sim("ardupilot", speed=2, hand="mouse")) as url:
        desk.open(url)
        desk.calibrate("Accelerometer").click()
        desk.sees("1 of 10 poses", 60, ".now")
        desk.page.locator("attitude-scene[turnable]").focus()
        for pose, done in (("Right", 2), ("Back", 3)):  # a quarter of a roll each
            for _ in range(6):
                desk.page.keyboard.press("ArrowRight")
            desk.sees(f"{done} of 10 poses", 60, ".now")
            desk.sees(pose, 10, f".faces li.done:has-text('{pose}')")
        assert desk.complaints == []


@pytest.mark.long
def test_a_real_vehicle_offers_no_hand(desk, tmp_path):
    with SimulatedVehicle("px4", seed=3) as real, service(tmp_path, "--connect", real.url) as url:
        desk.open(url, live(url))
        desk.sees("Asked for 50 samples a second", 30, ".asked")
        assert desk.page.locator(".hand").count() == 0
        assert desk.page.locator("attitude-scene[turnable]").count() == 0
