"""Criteria name the sensor, the number, the limit and what helps."""

from __future__ import annotations

import dataclasses

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.recording import Sensor
from mavcal.calib.review.criteria import criteria_of


def test_an_uncertainty_beyond_what_was_asked_for_warns_and_says_what_helps(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = dataclasses.replace(make_fit(Sensor.GYRO, 0, offset=[0.01] * 3), method="gyro-rest")
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    good = {c.id: c for c in criteria_of([fit], plan, {"uncertainty": 0.06})}
    bad = {c.id: c for c in criteria_of([fit], plan, {"uncertainty": 0.01})}
    assert good["gyro0-uncertainty"].verdict == Verdict.PASS
    assert good["gyro0-uncertainty"].remedy == ""
    assert bad["gyro0-uncertainty"].verdict == Verdict.WARN
    assert bad["gyro0-uncertainty"].text == "gyro 1: known to 0.057 deg/s, asked for 0.01 deg/s"
    assert "longer rest" in bad["gyro0-uncertainty"].remedy


def test_what_is_not_determined_is_named_with_its_movement(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    whole = make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3)
    fit = dataclasses.replace(
        whole, status=FitStatus.PARTIAL, undetermined=("matrix_zz",), movements={"matrix_zz": "hold it nose up"}
    )
    plan = compose([whole], ardupilot_parameters, ardupilot_fingerprint)
    (found,) = [c for c in criteria_of([fit], plan, {}) if c.id == "accel0-fit"]
    assert (found.verdict, found.remedy) == (Verdict.WARN, "hold it nose up")
    assert "matrix_zz" in found.text


def test_soft_iron_that_nothing_was_measured_of_is_one_sentence(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    whole = make_fit(Sensor.MAG, 0, offset=[1.0, 2.0, 3.0])
    matrix = tuple(name for name in parameter_names() if name.startswith("matrix"))
    fit = dataclasses.replace(
        whole, status=FitStatus.PARTIAL, undetermined=matrix, quality={**whole.quality, "soft_iron_kept": True}
    )
    plan = compose([whole], ardupilot_parameters, ardupilot_fingerprint)
    (found,) = [c for c in criteria_of([fit], plan, {}) if c.id == "mag0-fit"]
    assert found.verdict == Verdict.WARN
    assert "compass 1" in found.text
    assert "soft iron" in found.text
    assert "matrix" not in found.text


def test_a_compass_near_steel_and_with_few_directions_is_told(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    whole = make_fit(Sensor.MAG, 0, offset=[1.0, 2.0, 3.0])
    fit = dataclasses.replace(whole, quality={"field_ratio": 1.3, "coverage": 0.2, "p_value": 1e-9})
    plan = compose([whole], ardupilot_parameters, ardupilot_fingerprint)
    found = {c.id: c for c in criteria_of([fit], plan, {})}
    assert found["mag0-field"].verdict == found["mag0-coverage"].verdict == Verdict.WARN
    assert found["mag0-residuals"].verdict == Verdict.WARN
    assert "steel" in found["mag0-field"].remedy
    assert "130 %" in found["mag0-field"].text
