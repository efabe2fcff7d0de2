"""Traces of force and torque, and the waterfall of the predicted flight's error."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.airframe.answer import AirframeTrace, Quantity, Rollout, RolloutStep
from mavcal.calib.gap_report.flight_plots import LEGEND, binned, busiest, rollout_plot, rollout_plots, trace_plots
from tests.unit.gap_report.flown import rollouts, traces

FALLS = Rollout(
    1.0, Quantity.VELOCITY, "m/s", 0.8, 0.2, 0.1, 6.0 / 7.0, (0.8, 0.9),
    sequence=(RolloutStep("rotor_drag", 0.3), RolloutStep("cg_offset", 0.2)),
)  # fmt: skip


def bars(rollout):
    root = ElementTree.fromstring(rollout_plot(rollout))
    spans = [(float(r.attrib["x"]), float(r.attrib["width"])) for r in root.iter("rect")]
    return [e.text for e in root.iter("text")], spans


def test_what_the_effects_take_off_and_what_is_left_add_up_to_what_was_there():
    words, spans = bars(FALLS)
    whole, drag, shift, left, floor = (width for _, width in spans)
    assert drag + shift + left == pytest.approx(whole, abs=0.05)
    assert drag == pytest.approx(whole * 0.5 / 0.8, abs=0.05)
    assert floor == pytest.approx(whole * 0.1 / 0.8, abs=0.05)
    assert spans[1][0] + drag == pytest.approx(spans[0][0] + whole, abs=0.05)  # each begins where the last one ended
    assert spans[2][0] + shift == pytest.approx(spans[1][0], abs=0.05)
    assert words[2::2] == ["simulator as it is", "rotor drag", "cg offset", "with all effects", "floor"]
    assert words[3::2] == ["0.800", "0.300", "0.200", "0.200", "0.100"]


def test_a_waterfall_has_its_unit_and_the_share_that_is_closed():
    words, _ = bars(FALLS)
    assert words[:2] == ["Velocity after 1 s, m/s", "86 % closed (80 to 90 %)"]
    words, _ = bars(replace(FALLS, part="roll_doublets", closed=None, ci95=None))
    assert words[1] == "the part that is closed is not known, roll doublets held out"


def test_an_effect_that_makes_it_worse_runs_the_other_way():
    _, spans = bars(replace(FALLS, sequence=(RolloutStep("rotor_drag", 1.0), RolloutStep("cg_offset", 0.2))))
    assert spans[1][0] == pytest.approx(spans[0][0] + spans[0][1], abs=0.05)
    assert spans[1][0] + spans[1][1] == pytest.approx(spans[2][0] + spans[2][1], abs=0.05)


def test_without_effects_only_the_simulator_and_the_floor_are_drawn():
    words, spans = bars(replace(FALLS, after=0.8, closed=None, ci95=None, sequence=()))
    assert words[2::2] == ["simulator as it is", "floor"]
    assert words[1] is None
    assert len(spans) == 2


def test_every_horizon_has_its_picture_unless_it_is_not_known():
    assert len(rollout_plots(rollouts("motor_weak"))) == 5
    assert rollout_plots([replace(FALLS, before=float("nan")), replace(FALLS, before=0.0)]) == []


def test_numbers_and_names_lie_within_the_picture():
    long = replace(FALLS, sequence=(RolloutStep("translational_lift", 0.8), RolloutStep("yaw_coefficient", 0.2)))
    root = ElementTree.fromstring(rollout_plot(long))
    width = float(root.attrib["viewBox"].split()[2])
    for e in root.iter("text"):
        wide = 6.0 * len(e.text or "")
        left = float(e.attrib["x"]) - (wide if e.attrib["text-anchor"] == "end" else 0.0)
        assert left >= 0.0, e.text
        assert left + wide <= width, e.text


def test_force_and_torque_have_a_chart_an_axis_in_three_colours():
    force, torque = traces((0.35, 0.35, 0.0), (0.1, 0.1, 0.0))
    for trace, name in ((force, "Force"), (torque, "Torque")):
        drawn = trace_plots(trace)
        titles = [next(ElementTree.fromstring(picture).iter("text")).text for picture in drawn]
        assert titles == [f"{name} {axis}" for axis in "xyz"]
        for picture in drawn:
            colours = set(re.findall(r"stroke:(var\(--\w+\))", picture))
            assert colours == {colour for _, colour in LEGEND}
            assert "nan" not in picture


def test_a_long_flight_is_decimated_and_gaps_stay_gaps():
    t = np.arange(0.0, 15.0, 0.0025)
    values = np.sin(t)
    values[(t > 5.0) & (t < 6.0)] = np.nan
    x, mean = binned(t, values)
    assert len(x) == 300
    held = np.isfinite(mean)
    np.testing.assert_allclose(mean[held], np.sin(x[held]), atol=0.01)
    assert ((x > 5.05) & (x < 5.95) == ~held).mean() > 0.99
    assert max(map(len, trace_plots(traces((0.1, 0.1, 0.1), (0.1, 0.1, 0.1))[0]))) < 20_000


def test_the_seconds_are_those_that_the_effects_change_most():
    t = np.arange(0.0, 100.0, 0.02)
    burst = np.where((t > 60.0) & (t < 70.0), 1.0, 0.0)[:, None] * np.array([0.0, 1.0, 0.0])
    found = busiest(AirframeTrace("force", "m/s2", t, burst, np.zeros_like(burst), burst))
    assert t[found.start] <= 60.0
    assert t[found.stop - 1] >= 69.9
    assert t[found.stop - 1] - t[found.start] == pytest.approx(15.0, abs=0.1)


@pytest.mark.parametrize("seconds", [8.0, 15.0])
def test_a_short_flight_is_drawn_whole(seconds):
    t = np.arange(0.0, seconds, 0.02)
    still = np.zeros((len(t), 3))
    found = busiest(AirframeTrace("force", "m/s2", t, still, still, still))
    assert (found.start, found.stop) == (0, len(t))


def test_what_was_never_measured_has_no_chart():
    t = np.arange(0.0, 20.0, 0.1)
    none = np.full((len(t), 3), np.nan)
    assert trace_plots(AirframeTrace("torque", "rad/s2", t, none, none, none)) == []
    assert trace_plots(AirframeTrace("torque", "rad/s2", t[:4], none[:4], none[:4], none[:4])) == []
