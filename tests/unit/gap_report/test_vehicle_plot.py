"""The vehicle from above: what is filled, where motors, centre of gravity and wind are drawn."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from mavcal.calib.airframe.answer import AirframePart, Geometry, Motor
from mavcal.calib.gap_report.vehicle_plot import centre_of_gravity, on_picture, vehicle_plot, weak_motors
from tests.unit.gap_report.flown import CENTRE, DRAG, PLUS, WEAK, absolute, drag_flight, flown, weak_motor, windy_null

HEXA = Geometry(
    "hexa", "x", tuple(Motor(math.cos(a), math.sin(a), (-1) ** k) for k in range(6) for a in [math.pi * k / 3]), "user"
)
COAXIAL = Geometry("octa", "x8", (*PLUS.motors, *(replace(m, spin=-m.spin) for m in PLUS.motors)), "assumed")


def discs(picture):
    """By the words of each motor its circle."""
    root = ElementTree.fromstring(picture)
    return {e.findtext("title"): e for e in root.iter("circle") if (e.get("class") or "").startswith("motor")}


def filled(picture):
    return [words for words, e in discs(picture).items() if "var(--before)" in e.attrib["style"].split(";")[0]]


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_motor_that_is_filled_is_the_one_that_is_named(number):
    drawn = vehicle_plot(AirframePart(PLUS), [replace(WEAK, instances=(number,))])
    [sick] = filled(drawn)
    assert sick.startswith(f"motor {number},")
    assert "0.92 times the simulated thrust" in sick
    place = discs(drawn)[sick]
    motor = PLUS.motors[number - 1]
    assert (float(place.attrib["cx"]), float(place.attrib["cy"])) == pytest.approx(
        on_picture(motor.x, motor.y), abs=0.1
    )


def test_without_a_weak_motor_none_is_filled():
    assert filled(vehicle_plot(AirframePart(PLUS), [DRAG, CENTRE])) == []
    assert weak_motors([DRAG]) == {}


@pytest.mark.parametrize("geometry", [PLUS, HEXA], ids=["quad", "hexa"])
def test_every_motor_has_its_number_and_its_direction(geometry):
    drawn = vehicle_plot(AirframePart(geometry), [])
    words = [e.text for e in ElementTree.fromstring(drawn).iter("text")]
    assert [w for w in words if re.fullmatch(r"\d", w)] == [str(n + 1) for n in range(len(geometry.motors))]
    ways = ["counter-clockwise" if m.spin > 0 else "clockwise" for m in geometry.motors]
    assert [words.split("turns ")[1] for words in discs(drawn)] == ways


def test_forward_is_up_and_right_is_right():
    ahead, (x, y) = on_picture(1.0, 0.0), on_picture(0.0, 0.0)
    assert ahead[0] == x
    assert ahead[1] < y
    assert on_picture(0.0, 1.0)[0] > x


@pytest.mark.parametrize(("spin", "sweep"), [(1, "0"), (-1, "1")])
def test_an_arc_runs_the_way_that_the_propeller_turns(spin, sweep):
    """SVG's sweep flag 1 runs clockwise on the screen, which is how the vehicle is seen."""
    one = Geometry("quad", "plus", (Motor(0.0, 1.0, spin),), "user")
    [flags] = re.findall(r"A[\d.]+ [\d.]+ 0 1 (\d)", vehicle_plot(AirframePart(one), []))
    assert flags == sweep


def test_motors_above_each_other_share_a_disc():
    drawn = vehicle_plot(AirframePart(COAXIAL), [replace(WEAK, instances=(7,))])
    assert len(discs(drawn)) == 4
    assert "3+7" in [e.text for e in ElementTree.fromstring(drawn).iter("text")]
    [sick] = filled(drawn)
    assert "motor 7, turns counter-clockwise, 0.92 times" in sick
    assert "7: -7.9 %" in drawn
    assert "motor 3, turns clockwise and" in sick


@pytest.mark.parametrize("shift", [(0.05, -0.03), (-0.2, 0.1)])
def test_the_centre_of_gravity_is_drawn_to_the_scale_of_the_arms(shift):
    moved = flown("cg_offset", *(absolute(n, v, 0.0, 0.01, "1") for n, v in zip("xy", shift, strict=True)))
    assert centre_of_gravity([moved]) == pytest.approx(shift)
    root = ElementTree.fromstring(vehicle_plot(AirframePart(PLUS), [moved]))
    [dot] = [e for e in root.iter("circle") if e.get("class") == "gravity"]
    at = float(dot.attrib["cx"]), float(dot.attrib["cy"])
    middle, arm = on_picture(0.0, 0.0), on_picture(1.0, 0.0)
    scale = middle[1] - arm[1]
    assert ((middle[1] - at[1]) / scale, (at[0] - middle[0]) / scale) == pytest.approx(shift, abs=1e-3)


def test_the_wind_blows_where_the_air_moves_to_with_north_up():
    def tip(north, east):
        drawn = vehicle_plot(AirframePart(PLUS, wind=(north, east)), [])
        [group] = [e for e in ElementTree.fromstring(drawn).iter("g") if e.get("class") == "wind"]
        shaft, head = (e.attrib["d"] for e in group.findall("path"))
        begin, end = (re.findall(r"-?[\d.]+", path)[:2] for path in (shaft, head))
        return [float(b) - float(a) for a, b in zip(begin, end, strict=True)]

    assert tip(4.0, 0.0) == pytest.approx([0.0, -61.2], abs=0.2)  # a southerly wind blows up
    assert tip(0.0, 4.0) == pytest.approx([61.2, 0.0], abs=0.2)
    assert "from 75 deg" in vehicle_plot(windy_null().airframe, ())


def test_a_calm_has_no_arrow_and_a_vehicle_without_a_frame_no_picture():
    assert 'class="wind"' not in vehicle_plot(AirframePart(PLUS, wind=(0.01, 0.01)), [])
    assert 'class="wind"' not in vehicle_plot(AirframePart(PLUS), [])
    assert vehicle_plot(AirframePart(wind=(3.0, 0.0)), [WEAK]) == ""


@pytest.mark.parametrize("report", [weak_motor(), drag_flight(), windy_null()], ids=["weak", "drag", "windy"])
def test_everything_lies_within_the_picture(report):
    root = ElementTree.fromstring(vehicle_plot(report.airframe, report.effects))
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    for e in root.iter("circle"):
        x, y, r = (float(e.attrib[n]) for n in ("cx", "cy", "r"))
        assert r <= x <= width - r
        assert r <= y <= height - r
    for e in root.iter("text"):
        x, wide = float(e.attrib["x"]), 6.2 * len(e.text)
        left = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[e.attrib["text-anchor"]] * wide
        assert left >= 0.0
        assert left + wide <= width, e.text
        assert float(e.attrib["y"]) <= height
