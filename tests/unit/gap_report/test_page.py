"""The page of a gap report: self-contained, escaped, with a picture for everything that the report has."""

from __future__ import annotations

import dataclasses
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.gap.schema import (
    GapReport,
    GapVerdict,
    LocatedGap,
    MultipleTesting,
    NotTestable,
    Power,
    Regime,
    Rival,
    SequenceStep,
    SeriesFit,
    Shrink,
    Unknown,
)
from mavcal.calib.gap_report import gap_to_html, verdict_sentence
from mavcal.calib.gap_report.series_plots import allan, spectrum, spectrum_plot
from mavcal.calib.gap_report.table_plots import waterfall
from mavcal.calib.gap_report.words import regime
from mavcal.calib.recording import Sensor
from tests.unit.gap.export.making import effect, report
from tests.unit.gap_report.flown import WIND, drag_flight, weak_motor, windy_null

EVIL = '<script>alert("x")</script>'


def a_series(count: int = 900) -> SeriesFit:
    rng = np.random.default_rng(5)
    t = np.arange(count) / 50.0
    current = 10.0 + 8.0 * np.sin(0.5 * t)
    part = np.outer(current, [0.1, -0.2, 0.05])
    ideal = 40.0 * rng.normal(size=(count, 3))
    residual = part + 0.3 * rng.normal(size=(count, 3))
    return SeriesFit(
        *(Sensor.MAG, (1,), t, residual, part, np.full(3, 0.3), "uT", {"mag_motor_current": part}),
        ideal=ideal,
        covariates={"current": current},
        power=np.full((count, 3), 0.09),
    )


def a_report() -> GapReport:
    rival = Rival("mag_hard_iron", 0.86, 48.0, EVIL)
    motor = dataclasses.replace(effect("mag_motor_current", per_ampere=(0.1, -0.2, 0.05)), confusable_with=(rival,))
    cells = tuple(
        LocatedGap(f"mag.{axis}", 1, Regime(kind, (low, low + 3.0), unit), nats, 1.0, "uT", 1e-9)
        for axis, nats in (("x", 0.4), ("y", 2.0))
        for kind, low, unit in (("all", 0.0, ""), ("current", 2.0, "A"), ("current", 5.0, "A"), ("band", 0.0, "Hz"))
    )
    steps = (SequenceStep("mag_motor_current", 0.97),)
    shrink = Shrink(
        2.1, 0.05, 0.0, "declared_noise", 0.97, (0.95, 0.99), nested=True, sequence=steps, rms={"mag": (2.0, 0.3, "uT")}
    )
    return dataclasses.replace(
        report(motor),
        where=cells,
        shrink=shrink,
        series=(a_series(),),
        not_testable=(NotTestable("accel_temp_scale", EVIL, "span >= 15 C"),),
        power=(Power("mag_hard_iron", "hard_iron.x", 0.02, "uT"),),
        multiple_testing=MultipleTesting(45, 0.005),
        warnings=(EVIL,),
    )


def pictures(page: str) -> list[str]:
    return re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)


def test_every_part_of_the_report_has_its_place() -> None:
    page = gap_to_html(a_report(), title="a flight")
    for heading in (
        *("Which effects", "How far the gap shrinks", "Where", "What the effects look like", "Noise"),
        *("What these data cannot tell apart", "Over time", "Real, simulated, corrected", "Not testable here"),
        *("How small an effect would have shown", "What was compared"),
    ):
        assert f"<h2>{heading}</h2>" in page
    assert len(pictures(page)) == 8  # waterfall, map, effect, spectrum, Allan, strip, current, overlay


def test_units_that_read_the_same_have_no_empty_pictures() -> None:
    """Three simulated compasses are equal to the last digit."""
    whole = a_report()
    (fit,) = whole.series
    equal = dataclasses.replace(fit, residual=0.0 * fit.residual, modelled=0.0 * fit.modelled, parts={})
    both = dataclasses.replace(whole, series=(fit, equal))
    assert len(pictures(gap_to_html(both))) == len(pictures(gap_to_html(whole)))


def test_pictures_are_well_formed_and_finite() -> None:
    for picture in pictures(gap_to_html(a_report())):
        ElementTree.fromstring(picture)
        assert "nan" not in picture
        assert "inf" not in picture.replace("info", "")


def test_nothing_from_a_file_reaches_the_page_as_markup_and_nothing_is_fetched() -> None:
    page = gap_to_html(a_report(), title=EVIL)
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?:", page)


@pytest.mark.parametrize("verdict", list(GapVerdict))
def test_a_report_without_anything_is_still_a_page(verdict: GapVerdict) -> None:
    bare = dataclasses.replace(report(), verdict=verdict)
    page = gap_to_html(bare)
    assert verdict_sentence(bare).split(".")[0] in page
    assert "<h2>Which effects</h2>" not in page
    assert pictures(page) == []


def test_numbers_that_are_not_finite_are_said_in_words() -> None:
    series = a_series()
    broken = dataclasses.replace(series, residual=np.zeros_like(series.residual), modelled=np.zeros((900, 3)), parts={})
    shrink = Shrink(float("nan"), float("nan"), 0.0, "declared_noise", None, None, nested=False)
    odd = dataclasses.replace(
        a_report(), series=(broken, a_series(20)), shrink=shrink, unknown=Unknown(flag=True, share=0.2, shape=EVIL)
    )
    page = gap_to_html(odd)
    assert "not known" in page
    for picture in pictures(page):
        assert "nan" not in ElementTree.tostring(ElementTree.fromstring(picture), encoding="unicode")


def test_spectrum_and_allan_deviation_of_white_noise() -> None:
    noise = 0.2 * np.random.default_rng(2).normal(size=40_000)
    _, density = spectrum(noise, 100.0)
    assert np.median(density) == pytest.approx(0.2 * np.sqrt(2 / 100.0), rel=0.1)
    tau, deviation = allan(noise, 100.0)
    first = tau < 1.0
    np.testing.assert_allclose(deviation[first], 0.2 / np.sqrt(100.0 * tau[first]), rtol=0.1)


def test_what_is_less_likely_than_something_else_is_not_found():
    sure, guess = effect("accel_bias", bias=(0.3, 0, 0)), effect("mag_delay", delay_s=0.05)
    guess = dataclasses.replace(guess, evidence=dataclasses.replace(guess.evidence, probability=0.21))
    found, _, doubted = verdict_sentence(report(sure, guess)).partition("In doubt, since something else is likelier: ")
    assert "(accel_bias)" in found
    assert "mag_delay" not in found
    assert "(mag_delay)" in doubted
    assert "In doubt" not in verdict_sentence(report(sure))


def test_sensors_that_were_not_compared_are_in_the_answer():
    lost = NotTestable("gyro", "gyro of instance 1 is in another frame than its reference", "the same frame")
    page = gap_to_html(dataclasses.replace(report(effect("accel_bias", bias=(0.1, 0.0, 0.0))), not_testable=(lost,)))
    box = page.split('class="verdict"')[1].split("</div>")[0]
    assert "Not compared, at least in part: gyroscope" in box
    assert "Not compared" not in gap_to_html(report(effect("accel_bias", bias=(0.1, 0.0, 0.0))))


def placed(picture: str) -> list[tuple[float, float, str]]:
    """Upright words that begin where they stand: right edge as drawn (6.2 units a letter), width of the picture."""
    root = ElementTree.fromstring(picture)
    width = float(root.attrib["viewBox"].split()[2])
    return [
        (float(e.attrib["x"]) + 6.2 * len(e.text or ""), width, e.text or "")
        for e in root.findall("text")
        if e.attrib.get("text-anchor") == "start"
    ]


def test_no_word_runs_out_of_its_picture():
    long = Shrink(
        0.009692, 0.0001222, 0.0, "declared_noise", 0.97, (0.95, 0.99), nested=True,
        sequence=(SequenceStep("accel_rotation", 0.001), SequenceStep("gyro_bias", 0.9874)), rms={},
    )  # fmt: skip
    for picture in (waterfall(long), spectrum_plot(a_series())):
        assert [words for right, width, words in placed(picture) if right > width] == []


def test_a_condition_that_never_changes_has_one_number():
    assert regime(LocatedGap("accel.x", 1, Regime("throttle", (0.0, 0.0), ""), 1.0, 1.0, "m/s2", 1e-9)) == "throttle 0"


def test_numbers_without_a_unit_have_none():
    page = gap_to_html(dataclasses.replace(report(), power=(Power("accel_scale", "scale.x", 0.0086, "1"),)))
    assert "0.0086</td>" in page


def test_a_flight_has_its_vehicle_its_prediction_and_its_traces():
    page = gap_to_html(weak_motor())
    for heading in (
        "The vehicle", "What to fly next", "How far the predicted flight improves", "Real, simulated, patched flight",
    ):  # fmt: skip
        assert f"<h2>{heading}</h2>" in page
    assert "<h2>Which effects</h2>" not in page  # no sensor is wrong
    assert len(pictures(page)) == 1 + 5 + 6  # from above, horizons, axes of force and torque
    for picture in pictures(page):
        ElementTree.fromstring(picture)
        assert "nan" not in picture


def test_an_effect_of_the_airframe_is_a_card_with_its_ratio_and_what_decides():
    card = gap_to_html(weak_motor()).split('<article class="effect">')[1].split("</article>")[0]
    said = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", card))
    assert "Motor 3 is 7.9 % weak (7.4 to 8.4) airframe" in said
    assert "probability 97 %" in said
    assert "0.921 times (0.916 to 0.926)" in said
    assert "a shifted centre of gravity, 86 % alike; what decides: hover at two thrusts" in said
    assert "SIM_ENGINE_MUL 0.96" in said


def test_what_was_needed_and_how_the_commands_were_known_is_on_the_page():
    page = re.sub(r"\s+", " ", gap_to_html(windy_null()))
    assert "LOG_BITMASK bits 0 and 18" in page
    assert "Commands of the motors: the logged outputs (RCOU) at 10 Hz; nothing to check them against." in page
    assert "Wind of 4.1 m/s from 75 deg: a finding about the day, not exported" in page


def test_sensors_and_airframe_stand_beside_each_other():
    bias = effect("accel_bias", bias=(0.3, 0.0, 0.0))
    both = dataclasses.replace(drag_flight(), effects=(*drag_flight().effects, WIND, bias))
    page = gap_to_html(both)
    assert "<h2>Which effects</h2>" in page
    assert page.count('<article class="effect">') == 3
    labels = re.findall(r'class="domain">(\w+)', page)
    assert labels == ["airframe", "airframe", "environment"]


def test_the_page_of_sensors_alone_says_nothing_of_the_airframe():
    page = gap_to_html(a_report())
    assert "<h2>The vehicle</h2>" not in page
    assert 'class="domain"' not in page
    assert "What the real sensors read" in page


def test_names_from_a_flight_are_escaped():
    part = dataclasses.replace(weak_motor().airframe, manoeuvres=(EVIL,), facts={EVIL: 1.0})
    assert "<script" not in gap_to_html(dataclasses.replace(weak_motor(), airframe=part))


@pytest.mark.parametrize("flight", [weak_motor, drag_flight, windy_null])
def test_a_page_of_a_flight_is_small(flight):
    assert len(gap_to_html(flight())) < 130_000
