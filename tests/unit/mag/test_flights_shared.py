"""Compasses of recorded flights whose truth is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import ParameterTimeline

pytestmark = pytest.mark.shared


def one(shared_data, name, method, instance=0, **options):
    recording = logs.read(str(shared_data / name))
    return METHODS[method].run(recording, {"instance": instance, **options})[0]


@pytest.mark.long
def test_the_offset_of_the_biased_flight(shared_data):
    biased = one(shared_data, "sitl_flights/bias.bin", "mag-flight")
    clean = one(shared_data, "sitl_flights/bias.bin", "mag-flight", instance=1)
    for fit, truth in ((biased, [-6.0, 4.0, -3.0]), (clean, [0.0, 0.0, 0.0])):
        error = np.array(fit.native["change_of_offset_body"]) - truth
        assert np.abs(error).max() < 0.6
        assert (np.abs(error) < 3.0 * np.array(fit.native["offset_body_sd"])).all()


@pytest.mark.long
def test_the_soft_iron_of_the_mixed_flight(shared_data):
    fit = one(shared_data, "sitl_flights/mix.bin", "mag-flight")
    truth = np.array([[0.95, -0.04, 0.05], [-0.04, 1.08, 0.06], [0.05, 0.06, 1.1]])
    assert np.abs(fit.model.matrix - truth).max() < 0.02


@pytest.mark.long
def test_the_motors_of_the_driven_flight(shared_data):
    fit = one(shared_data, "sitl_flights/vib_motor_temp.bin", "mag-motor", instance=1)
    assert fit.native["drive"] == "current"
    assert np.allclose(fit.native["interference"], [0.3, -0.2, 0.4], atol=0.012)


@pytest.mark.long
def test_no_compensation_where_there_is_nothing(shared_data):
    fit = one(shared_data, "sitl_flights/null.bin", "mag-motor")
    assert fit.status == FitStatus.OK
    assert not fit.native["proposed"]


def test_a_corrupt_compensation_is_the_cause(shared_data):
    fit = one(shared_data, "df_loganalyzer_examples/nan.log", "mag-motor")
    assert fit.status == FitStatus.REFUSED
    assert "COMPASS_MOT_X = nan" in fit.message


@pytest.mark.long
@pytest.mark.parametrize("kind", [0, 2])
def test_a_flight_with_its_motors_compensated_is_not_sent_to_compensate_them(shared_data, kind):
    recording = logs.read(str(shared_data / "sitl_flights/vib_motor_temp.bin"))
    in_force = {"COMPASS_MOTCT": kind, "COMPASS_MOT2_X": -3.0, "COMPASS_MOT2_Y": 2.0, "COMPASS_MOT2_Z": -4.0}
    timeline = ParameterTimeline.constant({**recording.parameters.final(), **in_force})
    (fit,) = METHODS["mag-flight"].run(dataclasses.replace(recording, parameters=timeline), {"instance": 1})
    told = [text for text in fit.warnings if "the motors add up to" in text]
    assert told
    assert any("mag-motor" in text for text in told) is (kind == 0)
