from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.mag.blur import Rates
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.procedures.mag import SPEC, MagProcedure
from mavcal.calib.procedures.mag_track import BodyMotion, MagTrack
from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt
from mavcal.calib.procedures.spec import OperatorAnswer, ProcedureContext
from mavcal.calib.recording import Identity, Sensor

FIELD = EarthField([20.5, 1.2, 44.0], norm_sd=0.15)
WITHOUT_SHRINKING = (Phase.explicit, Phase.generate)  # a run takes too long for it
CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0}, earth_field=FIELD)


def run(recording, chunks=None, context=CONTEXT, **options):
    procedure = MagProcedure(SPEC.validated(options), context)
    steps = [s for part in (chunks or [recording]) for s in procedure.feed(part)]
    return procedure, steps + list(procedure.end())


@pytest.fixture
def clean(bench):
    """A bench with ideal inertial sensors, so that the vertical is right."""

    def make(**fields):
        accel = replace(bench().accels[0], offset=(0.0, 0.0, 0.0), sensitivity=np.eye(3))
        return bench(accels=(accel,), **fields)

    return make


def deviations(fit, truth, field=FIELD):
    correction = np.linalg.inv(truth.sensitivity)
    values, vectors = np.linalg.eigh(correction.T @ correction)
    symmetric = (vectors * np.sqrt(values)) @ vectors.T
    error = fit.values - np.concatenate([truth.offset, symmetric.ravel()])
    return np.abs(error / fit.sd)


def test_hard_and_soft_iron_of_every_compass_are_found_within_their_uncertainty(clean):
    one = clean().mags[0]
    two = replace(one, offset=(-30.0, 12.0, 5.0), quantum=0.1)
    procedure, _ = run(clean(mags=(one, two)).tumble(60.0).record())
    assert isinstance(procedure.outcome, Done), procedure.outcome
    for fit, truth in zip(procedure.outcome.results, (one, two), strict=True):
        assert (deviations(fit, truth) < 4.5).all()
        assert fit.quality["heading_sd_deg"] <= 0.3
        assert fit.quality["orientation"]["verdict"] == "as_stated"
        assert abs(fit.quality["field_ratio"] - 1.0) < 0.05


@pytest.mark.long
def test_it_ends_early_and_later_where_more_is_asked(clean):
    recording = clean().tumble(90.0).record()
    quick, _ = run(recording, uncertainty=0.5)
    exact, _ = run(recording, uncertainty=0.1)
    assert quick.time < exact.time < 185.0


def test_a_turn_about_one_axis_never_ends_and_says_what_is_missing(clean):
    procedure, steps = run(clean().turn(60.0, (0, 0, 40)).record(), patience=40.0)
    assert isinstance(procedure.outcome, GaveUp)
    assert "down" in procedure.outcome.remedy
    prompts = [s for s in steps if isinstance(s, Prompt)]
    assert prompts[-1].direction is not None
    assert prompts[-1].rotate


def test_a_compass_that_is_mounted_turned_is_recognised(clean):
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # reads x where y is
    truth = replace(clean().mags[0], sensitivity=clean().mags[0].sensitivity @ turned.T)
    procedure, _ = run(clean(mags=(truth,)).tumble(60.0).record())
    orientation = procedure.outcome.results[0].quality["orientation"]
    assert orientation["verdict"] == "rotated"
    assert orientation["name"] == "yaw_90"
    np.testing.assert_array_equal(orientation["matrix"], turned)


ODD = Rotation.from_euler("ZYX", [29.0, -8.0, 3.0], degrees=True).as_matrix()
MIRROR = np.diag([1.0, 1.0, -1.0])


def mounted(clean, *matrices):
    """Compasses that each of `matrices` takes to the body."""
    one = clean().mags[0]
    return clean(mags=tuple(replace(one, sensitivity=one.sensitivity @ m.T) for m in matrices)).tumble(60.0)


def test_a_compass_mounted_at_odd_angles_is_fitted_with_them(clean):
    (fit,) = run(mounted(clean, ODD).record())[0].outcome.results
    found = fit.quality["orientation"]
    assert (found["verdict"], found["nearest"]) == ("by_angles", "none")
    assert angle_between(np.array(found["matrix"]), ODD) < np.radians(1.0)
    assert [found["roll"], found["pitch"], found["yaw"]] == pytest.approx([3.0, -8.0, 29.0], abs=1.0)
    assert all(0.2 < sd < 0.7 for sd in found["sd_deg"])
    assert found["askew_deg"] == pytest.approx(np.degrees(angle_between(np.eye(3), ODD)), abs=1.0)
    assert any(text.startswith("mounted turned by roll") for text in fit.warnings)
    assert json.loads(json.dumps(found))["yaw"] == found["yaw"]


def test_a_mirrored_compass_is_refused_by_name(clean):
    outcome = run(mounted(clean, MIRROR).record())[0].outcome
    assert isinstance(outcome, GaveUp)
    assert "its z axis reads with the wrong sign, which no mounting does" in outcome.cause


@pytest.mark.parametrize("known", [True, False])
def test_beside_another_compass_a_mirrored_one_is_known_wherever_it_is(clean, known):
    context = CONTEXT if known else replace(CONTEXT, earth_field=None)
    first, second = run(mounted(clean, np.eye(3), MIRROR).record(), context=context)[0].outcome.results
    assert first.quality["orientation"]["verdict"] == "as_stated"
    assert (second.status, second.quality["orientation"]["verdict"]) == ("refused", "mirrored")


def test_fast_turns_are_left_out_and_mild_blur_is_computed_back(clean):
    truth = replace(clean().mags[0], noise=0.05)
    context = replace(CONTEXT, identity=Identity(autopilot="ardupilot"), parameters={})
    recording = clean(mags=(truth,)).tumble(8.0, 900.0).tumble(40.0, 80.0).record()
    fit = run(recording, context=context, uncertainty=0.03)[0].outcome.results[0]
    assert (deviations(fit, truth) < 4.5).all()
    assert fit.quality["blurred"] > 40


def test_a_magnet_at_the_compass_ends_the_job_within_seconds(clean):
    truth = replace(clean().mags[0], offset=(380.0, 0.0, 0.0))
    procedure, _ = run(clean(mags=(truth,)).tumble(60.0).record())
    assert isinstance(procedure.outcome, GaveUp)
    assert "magnet" in procedure.outcome.cause
    assert procedure.elapsed < 10.0


def test_the_field_is_held_against_the_model_from_the_first_second(clean):
    truth = replace(clean().mags[0], offset=(40.0, 20.0, -30.0))
    _, steps = run(clean(mags=(truth,)).tumble(20.0).record())
    first = next(s for s in steps if isinstance(s, Progress))
    assert first.detail["model_ut"] == pytest.approx(FIELD.norm)
    assert any("is near, or it is not calibrated" in w for w in first.detail["warnings"])


def test_without_a_place_the_scale_is_left_open_and_said_so(clean):
    context = replace(CONTEXT, earth_field=None)
    fit = run(clean().tumble(60.0).record(), context=context)[0].outcome.results[0]
    assert any("place is not known" in w for w in fit.warnings)
    assert abs(np.linalg.det(fit.model.matrix) - 1.0) < 1e-9


@pytest.mark.long
def test_the_operator_may_finish_early_and_the_result_says_so(clean):
    recording = clean().tumble(60.0).record()
    procedure = MagProcedure(SPEC.validated({"uncertainty": 0.02}), CONTEXT)
    procedure.feed(recording.between(0.0, 145.0))
    assert procedure.outcome is None
    procedure.answer("finish")
    assert "operator" in procedure.outcome.because
    assert any("ended by the operator" in w for w in procedure.outcome.results[0].warnings)
    again = MagProcedure(SPEC.validated({"uncertainty": 0.02}), CONTEXT)
    again.schedule([OperatorAnswer(procedure.time, "finish")])
    again.feed(recording)
    np.testing.assert_array_equal(again.outcome.results[0].values, procedure.outcome.results[0].values)


def test_a_frozen_compass_is_left_out(clean):
    recording = clean(mags=clean().mags * 2).tumble(60.0).record()
    recording.channel(Sensor.MAG, 1).values[:] = recording.channel(Sensor.MAG, 1).values[0]
    procedure, _ = run(recording)
    assert [f.instance for f in procedure.outcome.results] == [0]
    assert any("compass 2 is frozen" in w for w in procedure.warnings)


def test_a_compass_without_noise_may_rest_before_it_is_turned():
    """As ArduCopter's simulator is: all readings alike. Their mean is rounded, and rounding is no movement."""
    rng = np.random.default_rng(5)
    for count in range(10, 50):
        for at in np.round(300.0 * rng.normal(size=(30, 3))):
            track = MagTrack(0, FIELD, None, np.eye(3), quantum=0.1, relative=False)
            rows, square = np.zeros((count, 3)), np.zeros((count, 3, 3))
            turn = Rates(np.arange(count) / 25.0, rows, square, square, np.ones(count, dtype=bool), 0.01)
            still = BodyMotion(turn, rows, rows)
            track.add(np.tile(0.1 * at, (count, 1)), still)
            track.update()
            assert track.coverage.count == 0


@pytest.mark.long
def test_one_bad_compass_does_not_keep_the_good_one_for_ever(clean):
    bad = replace(clean().mags[0], noise=6.0)
    procedure, _ = run(clean(mags=(clean().mags[0], bad)).tumble(80.0).record(), patience=60.0)
    assert isinstance(procedure.outcome, Done)
    assert "1 of 2 compasses" in procedure.outcome.because
    assert math.isclose(procedure.elapsed, 60.0, abs_tol=3.0)


@pytest.mark.long
@settings(
    deadline=None, max_examples=4, phases=WITHOUT_SHRINKING, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cuts=st.lists(st.floats(100.0, 145.0), max_size=60))
def test_steps_and_digits_do_not_depend_on_the_chunks(clean, chunks, cuts):
    recording = clean().tumble(45.0).record()
    whole, steps = run(recording)
    cut, pieces = run(recording, chunks(recording, cuts))
    assert [repr(s) for s in steps if not isinstance(s, Done)] == [repr(s) for s in pieces if not isinstance(s, Done)]
    np.testing.assert_array_equal(whole.outcome.results[0].values, cut.outcome.results[0].values)
