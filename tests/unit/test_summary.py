"""What recordings, fits and reports say of themselves: numbers with units, and nothing of a file becomes markup."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from mavcal.calib.fit import FitBuilder
from mavcal.calib.gap.schema import (
    EffectEstimate,
    EffectEvidence,
    GapReport,
    GapVerdict,
    Inputs,
    NotTestable,
    ParameterEstimate,
    Unknown,
)
from mavcal.calib.noise.allan_fit import fit_allan
from mavcal.calib.recording import Channel, Identity, ParameterTimeline, Recording, Sensor, Stage
from mavcal.calib.summary import Summary, counted
from mavcal.calib.triad import ThermalPolynomial, TriadModel

EVIL = "<script>alert(1)</script>"


def channel(source: str = "RAW_IMU", count: int = 1201) -> Channel:
    return Channel(Sensor.MAG, 0, np.arange(count) / 50, np.ones((count, 3)), "uT", Stage.CORRECTED, source)


def recording(source: str = "flight.bin") -> Recording:
    parameters = ParameterTimeline.constant({"COMPASS_OFS_X": 1.0, "COMPASS_OFS_Y": 2.0})
    identity = Identity(autopilot="ardupilot", firmware=(4, 5, 7))
    return Recording((channel(source),), parameters, identity=identity, source=source)


def report(word: str = "accel_bias") -> GapReport:
    inputs = Inputs(None, None, 100.0, 60.0, "pose", 0.1, "", {}, "0")
    bias = ParameterEstimate("x", 0.0512, 0.001, (0.049, 0.053), "m/s2")
    effect = EffectEstimate(word, Sensor.ACCEL, (1,), (bias,), EffectEvidence(90.0, 3, 1e-9, 0.9991, 0.8))
    missing = (NotTestable(word, "no field", "a magnetometer"),)
    return GapReport(inputs, GapVerdict.PARTLY_EXPLAINED, (), (effect,), Unknown(flag=True), not_testable=missing)


def test_a_recording_says_its_length_its_vehicle_and_its_channels():
    title, head, row = repr(recording()).splitlines()
    assert all(token in title for token in ("flight.bin", "24.0 s", "ardupilot 4.5.7", "2 parameters"))
    assert head.split() == ["channel", "samples", "rate", "unit", "stage", "source"]
    assert re.split(r"\s{2,}", row.strip()) == ["mag 1", "1 201", "50 Hz", "uT", "corrected", "flight.bin"]
    empty = repr(Recording(()))
    assert all(token in empty for token in ("no samples", "no vehicle", "0 parameters"))


def test_a_fit_says_its_values_with_their_uncertainty_and_unit():
    covariance = np.diag([0.02**2, 0.02**2, 0.0, *[1e-6] * 9])
    fit = FitBuilder.of("mag-sphere", channel()).fitted(
        TriadModel(np.array([12.01349, -7.0, 3.0])), covariance, message="", n_used=1200, residual_rms=0.31,
        condition_number=1.0, undetermined={"offset_z": "turn it over"}, warnings=["the field is weak"],
    )  # fmt: skip
    text = repr(fit)
    assert text.startswith("mag-sphere of mag 1: partial; 1 200 of 1 201 samples, residual 0.31 uT rms\n")
    assert "12.013 ± 0.020" in text
    assert text.splitlines()[2].split()[-2:] == ["undetermined", "uT"]
    assert "undetermined offset_z: turn it over" in text
    assert "the field is weak" in text
    assert "relative" not in text
    assert "relative to the calibration in force" in repr(dataclasses.replace(fit, relative=True))


def test_a_fit_of_the_drift_has_a_row_a_power():
    curve = ThermalPolynomial(35.0, 20.0, 60.0, np.array([[1e-4, 1e-6], [2e-4, 2e-6], [3e-4, 3e-6]]))
    covariance = np.zeros((18, 18))
    np.fill_diagonal(covariance[12:, 12:], 1e-16)
    fit = FitBuilder.of("thermal-poly", channel()).fitted(
        TriadModel(polynomial=curve), covariance, message="", n_used=3, residual_rms=0.1, condition_number=1.0
    )
    lines = repr(fit).splitlines()
    assert lines[-2].split()[:2] == ["drift,", "T^1"]
    assert "(100000 ± 10)e-9" in lines[-2]
    assert "(1000 ± 10)e-9" in lines[-1]
    assert lines[-1].endswith("uT/degC^2")
    assert not any("matrix" in line for line in lines)


def test_a_refused_fit_says_why_and_no_value():
    title, why = repr(FitBuilder.of("mag-sphere", channel()).refused("3 % seen")).splitlines()
    assert all(token in title for token in ("mag-sphere", "mag 1", "refused"))
    assert why.strip() == "3 % seen"


def test_a_fit_of_noise_says_its_figures():
    noise = 0.3 * np.random.default_rng(1).normal(size=(4000, 3))
    fit = fit_allan(Channel(Sensor.MAG, 0, np.arange(4000) / 50, noise, "uT", Stage.RAW, "test"))
    rows = {line.split()[0]: line for line in repr(fit).splitlines()[2:5]}
    assert set(rows) == {"N", "B", "K"}
    assert rows["N"].endswith("uT/sqrt(Hz)")
    assert "0.04" in rows["N"]  # 0.3 uT a sample at 50 Hz: 0.042


def test_a_report_says_its_effects_and_what_has_no_name():
    text = repr(report())
    title, _, row, *notes = text.splitlines()
    assert "partly explained" in title
    assert "1 effect" in title
    assert all(token in row for token in ("accel_bias", "0.0512", "0.049 to", "0.053", "m/s2"))
    assert any("no name" in note for note in notes)
    assert any("accel_bias" in note and "1 effect" in note for note in notes)


@pytest.mark.parametrize("made", [recording(EVIL), report(EVIL), FitBuilder.of(EVIL, channel()).refused(EVIL)],
                         ids=["recording", "report", "fit"])  # fmt: skip
def test_nothing_of_a_file_becomes_markup(made):
    html = made._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;" in html


def test_a_summary_without_rows_has_no_table():
    assert "<table" not in Summary("title", ("a",), (), ("note",)).html()
    assert Summary("title", ("a",), (), ("note",)).text() == "title\n  note"
    assert counted(1234567) == "1 234 567"
