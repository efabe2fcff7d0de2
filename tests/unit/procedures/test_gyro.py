from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from mavcal.calib.procedures.gyro import SPEC, GyroProcedure
from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity, Sensor

WITHOUT_SHRINKING = (Phase.explicit, Phase.generate)  # a run takes too long for it
CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0})


def run(recording, chunks=None, context=CONTEXT, **options):
    procedure = GyroProcedure(SPEC.validated(options), context)
    steps = [s for part in (chunks or [recording]) for s in procedure.feed(part)]
    return procedure, steps + list(procedure.end())


def deviations(fit, truth):
    return np.abs(fit.model.offset - truth) / fit.sd[:3]


def test_the_offsets_of_every_gyro_are_found_within_their_uncertainty(bench):
    base = bench().gyros[0]
    gyros = (base, replace(base, offset=(-0.02, 0.003, 0.0)), replace(base, offset=(0.001, 0.002, -0.03), quantum=1e-3))
    recording = bench(gyros=gyros, accels=bench().accels * 3).hold(30.0).record()
    procedure, _ = run(recording)
    assert isinstance(procedure.outcome, Done)
    assert [f.instance for f in procedure.outcome.results] == [0, 1, 2]
    for fit, truth in zip(procedure.outcome.results, gyros, strict=True):
        assert (deviations(fit, truth.offset) < 4.5).all()
        assert fit.sd[:3].max() <= math.radians(0.01)
        assert fit.temperature == pytest.approx(35.0)


def test_it_ends_as_soon_as_the_uncertainty_is_reached(bench):
    recording = bench().hold(60.0).record()
    coarse, _ = run(recording, uncertainty=0.05)
    fine, _ = run(recording, uncertainty=0.003)
    assert coarse.time < fine.time < 160.0


@pytest.mark.parametrize(
    ("rate", "mags", "cause"),
    [
        ((0, 0, 20), True, "turn"),
        ((0, 0, 3), True, "field"),
        ((0, 0, 0.6), True, "field"),
        ((0, 2, 0), False, "tilted"),
    ],
)
def test_a_steady_turn_is_not_rest(bench, rate, mags, cause):
    made = bench() if mags else bench(mags=())
    procedure, _ = run(made.turn(60.0, rate).record(), patience=40.0)
    assert isinstance(procedure.outcome, GaveUp)
    assert cause in procedure.outcome.cause


def test_a_turn_too_fast_for_an_offset_is_refused_without_a_compass(bench):
    procedure, _ = run(bench(mags=()).turn(60.0, (0, 0, 9)).record(), patience=40.0)
    assert isinstance(procedure.outcome, GaveUp)
    assert "turning" in procedure.outcome.cause


def test_without_a_compass_the_result_says_what_cannot_be_known(bench):
    procedure, _ = run(bench(mags=()).hold(20.0).record())
    assert any("no compass" in w for w in procedure.outcome.results[0].warnings)


def test_a_knock_begins_the_rest_anew_and_says_what_moved(bench):
    made = bench().hold(3.0)
    made.hold(20.0, made._last * made._last.from_rotvec([0.05, 0.0, 0.0]), move=0.3)
    procedure, steps = run(made.record(), uncertainty=0.005)
    assert isinstance(procedure.outcome, Done)
    assert any("Not at rest: " in s.text for s in steps if isinstance(s, Prompt))
    assert (deviations(procedure.outcome.results[0], bench().gyros[0].offset) < 4.5).all()


def test_a_quiet_quantised_gyro_ends_with_what_its_stream_allows(bench):
    gyro = replace(bench().gyros[0], noise=4e-5, quantum=1e-3)
    procedure, _ = run(bench(gyros=(gyro,)).hold(40.0).record())
    fit = procedure.outcome.results[0]
    assert (deviations(fit, gyro.offset) < 4.5).all()
    assert fit.sd[:3].max() > math.radians(0.01)
    assert "resolution" in procedure.outcome.because
    assert any("resolution" in w for w in fit.warnings)


def test_a_recording_that_is_too_short_says_what_is_missing(bench):
    procedure, _ = run(bench().hold(2.0).record())
    assert isinstance(procedure.outcome, GaveUp)
    assert "recording ends" in procedure.outcome.cause
    assert procedure.outcome.remedy


def test_nan_rows_are_left_out_with_a_warning(bench):
    recording = bench().hold(20.0).record()
    recording.channel(Sensor.GYRO).values[7] = np.nan
    procedure, _ = run(recording)
    assert isinstance(procedure.outcome, Done)
    (said,) = (w for w in procedure.outcome.results[0].warnings if "finite" in w)
    assert said.startswith("1 ")
    assert "gyro 1" in said


def test_an_absent_instance_is_named_and_the_others_are_calibrated(bench):
    context = ProcedureContext(CONTEXT.identity, {Sensor.GYRO: (0, 2)}, parameters=CONTEXT.parameters)
    procedure, _ = run(bench().hold(30.0).record(), context=context)
    assert [f.instance for f in procedure.outcome.results] == [0]
    assert any("gyro 3" in w and "sends no samples" in w for w in procedure.outcome.results[0].warnings)


def test_a_frozen_gyro_is_left_out_and_a_lone_one_ends_the_job(bench):
    two = bench(gyros=bench().gyros * 2, accels=bench().accels * 2).hold(30.0).record()
    two.channel(Sensor.GYRO, 1).values[50:] = 0.01
    procedure, _ = run(two, uncertainty=0.004)
    assert [f.instance for f in procedure.outcome.results] == [0]
    assert any("gyro 2 is frozen" in w for w in procedure.warnings)
    one = bench().hold(30.0).record()
    one.channel(Sensor.GYRO).values[50:] = 0.01
    assert "frozen" in run(one, uncertainty=0.004)[0].outcome.cause


def test_a_vehicle_without_a_gyro_stream_is_told_so(bench):
    recording = bench(gyros=()).hold(10.0).record()
    procedure, _ = run(recording)
    assert isinstance(procedure.outcome, GaveUp)
    assert "no gyro" in procedure.outcome.cause


def test_without_parameters_the_fit_is_relative(bench):
    procedure, _ = run(bench().hold(20.0).record(), context=ProcedureContext())
    assert procedure.outcome.results[0].relative


def test_progress_grows_with_the_information_once_a_second(bench):
    _, steps = run(bench().hold(60.0).record(), uncertainty=0.002)
    known = [s for s in steps if isinstance(s, Progress) and s.current]
    assert len(known) > 2
    assert [k.current for k in known] == sorted(k.current for k in known)
    assert known[-1].current <= known[-1].target == 100.0
    assert known[-1].detail["offset_sd_deg_s"] < known[0].detail["offset_sd_deg_s"]
    assert known[0].eta > known[-1].eta


@settings(
    deadline=None, max_examples=8, phases=WITHOUT_SHRINKING, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cuts=st.lists(st.floats(100.0, 112.0), max_size=30))
def test_steps_and_digits_do_not_depend_on_the_chunks(bench, chunks, cuts):
    recording = bench().hold(12.0).record()
    whole, steps = run(recording)
    cut, pieces = run(recording, chunks(recording, cuts))
    assert [repr(s) for s in steps if not isinstance(s, Done)] == [repr(s) for s in pieces if not isinstance(s, Done)]
    np.testing.assert_array_equal(whole.outcome.results[0].values, cut.outcome.results[0].values)
    np.testing.assert_array_equal(whole.outcome.results[0].covariance, cut.outcome.results[0].covariance)
