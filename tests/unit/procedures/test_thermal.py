from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.procedures.thermal import SPEC, ThermalProcedure
from mavcal.calib.recording import Identity, Sensor

WITHOUT_SHRINKING = (Phase.explicit, Phase.generate)  # a run takes too long for it
CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0})
ACCEL_DRIFT = np.array([[7e-3, 6e-5, 2e-7], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, -3e-7]])
GYRO_DRIFT = np.array([[3.5e-4, 2e-6, 0.0], [-2.5e-4, 0.0, 1e-8], [1.5e-4, 0.0, 0.0]])


def warming(start, end, tau):
    return lambda t: end - (end - start) * np.exp(-(t - t[0]) / tau)


@pytest.fixture
def warm(bench):
    def make(seconds=120.0, curve=None, **fields):
        accel = replace(bench().accels[0], thermal=ACCEL_DRIFT)
        gyro = replace(bench().gyros[0], thermal=GYRO_DRIFT)
        fields = {"accels": (accel,), "gyros": (gyro,), "rate": 25.0, **fields}
        made = bench(temperature=curve or warming(20.0, 58.0, 60.0), **fields)
        return made.hold(seconds) if seconds else made

    return make


def run(recording, chunks=None, context=CONTEXT, **options):
    procedure = ThermalProcedure(SPEC.validated(options), context)
    steps = [s for part in (chunks or [recording]) for s in procedure.feed(part)]
    return procedure, steps + list(procedure.end())


def deviations(fit, drift):
    error = fit.model.polynomial.coefficients - drift[:, : fit.degree]
    return np.abs(error.ravel() / fit.sd[12:])


def test_the_drift_of_every_unit_is_found_within_its_uncertainty(warm):
    accels = warm().accels * 2
    procedure, _ = run(warm(accels=accels, gyros=warm().gyros * 2).record())
    assert isinstance(procedure.outcome, Done), procedure.outcome
    assert [(f.sensor, f.instance) for f in procedure.outcome.results] == [
        (Sensor.ACCEL, 0),
        (Sensor.ACCEL, 1),
        (Sensor.GYRO, 0),
        (Sensor.GYRO, 1),
    ]
    for fit in procedure.outcome.results:
        assert (deviations(fit, ACCEL_DRIFT if fit.sensor == Sensor.ACCEL else GYRO_DRIFT) < 4.5).all()
    assert "span covered" in procedure.outcome.because


def test_it_ends_at_the_asked_for_span_if_it_need_not_extend(warm):
    recording = warm().record()
    narrow, _ = run(recording, span=12.0, extend=False)
    wide, _ = run(recording, span=30.0, extend=False)
    assert narrow.time < wide.time
    poly = narrow.outcome.results[0].model.polynomial
    assert 12.0 <= poly.t_max - poly.t_min < 16.0


def test_a_temperature_that_settles_ends_it_too(warm):
    procedure, _ = run(warm(200.0, warming(20.0, 38.0, 12.0)).record(), span=40.0)
    assert "settled" in procedure.outcome.because


def test_a_warm_up_that_goes_on_extends_the_range_until_it_settles_and_says_when(warm):
    """From 20 to 58 degC with a time constant of 30 s; 0.2 degC/min is reached after 30 ln(38 * 2 / 0.2) = 178 s."""
    made = warm(300.0, warming(20.0, 58.0, 30.0))
    procedure, steps = run(made.record(), span=25.0)
    assert "has settled" in procedure.outcome.because
    poly = procedure.outcome.results[0].model.polynomial
    assert poly.t_max > 57.0
    told = [s for s in steps if isinstance(s, Progress) and s.eta is not None]
    began = procedure.time - procedure.elapsed
    halfway = next(s for s in told if "will settle at" in s.text and s.current >= 25.0)
    assert "will settle at 58 +- 1 degC" in halfway.text
    times = [s.detail["still_s"] for s in told]
    at = told.index(halfway)
    assert halfway.eta == pytest.approx(times[-1] - times[at], rel=0.25), (began, times[at])
    prompts = [s for s in steps if isinstance(s, Prompt)]
    assert "are covered, and the temperature still changes" in prompts[-1].text
    assert prompts[-1].answers == ("finish",)


def test_the_person_decides_when_a_warm_up_is_long_enough(warm):
    recording = warm(300.0, warming(20.0, 58.0, 60.0)).record()
    procedure = ThermalProcedure(SPEC.validated({"span": 12.0}), CONTEXT)
    began = recording.span[0]
    procedure.feed(recording.between(began, began + 90.0))
    assert procedure.outcome is None
    procedure.answer("finish")
    poly = procedure.outcome.results[0].model.polynomial
    assert poly.t_max - poly.t_min > 20.0


def test_a_narrow_range_is_refused_with_the_remedy(warm):
    outcome = run(warm(200.0, warming(30.0, 36.0, 12.0)).record())[0].outcome
    assert isinstance(outcome, GaveUp)
    assert "settled after 6.0 degC" in outcome.cause
    assert "cool the vehicle" in outcome.remedy


def test_a_temperature_that_never_moves_ends_it(warm):
    outcome = run(warm(100.0, lambda t: np.full(len(t), 41.0)).record(), patience=60.0)[0].outcome
    assert isinstance(outcome, GaveUp)
    assert "never moved" in outcome.cause


def test_a_vehicle_without_a_thermometer_is_told_so(warm):
    recording = warm(20.0).record()
    bare = recording.with_channels(c for c in recording.channels if c.sensor != Sensor.TEMPERATURE)
    outcome = run(bare)[0].outcome
    assert isinstance(outcome, GaveUp)
    assert "no temperature" in outcome.cause


def test_a_knock_in_the_middle_changes_the_pose_and_not_the_drift(warm):
    made = warm(25.0)
    made.hold(95.0, Rotation.from_euler("xyz", [6.0, -4.0, 0.0], degrees=True), move=0.5)
    procedure, steps = run(made.record())
    accel = procedure.outcome.results[0]
    assert (deviations(accel, ACCEL_DRIFT) < 4.5).all()
    assert accel.quality["poses"] == 2
    assert any("2 still spans" in w for w in accel.warnings)
    assert any("Do not touch it" in s.text for s in steps if isinstance(s, Prompt))
    assert (deviations(procedure.outcome.results[1], GYRO_DRIFT) < 4.5).all()


def test_the_operator_may_finish_when_the_range_is_wide_enough(warm):
    recording = warm().record()
    procedure = ThermalProcedure(SPEC.validated({}), CONTEXT)
    steps = procedure.feed(recording.between(0.0, 104.0))
    assert not [s for s in steps if isinstance(s, Prompt)][-1].answers
    procedure.feed(recording.between(104.0, 130.0))
    procedure.answer("finish")
    assert "operator" in procedure.outcome.because
    assert (deviations(procedure.outcome.results[0], ACCEL_DRIFT) < 4.5).all()


def test_a_vehicle_that_is_never_left_alone_gives_no_drift(warm):
    made = warm(0.0, warming(20.0, 58.0, 20.0))
    made.hold(200.0, tremor=1.5)
    outcome = run(made.record())[0].outcome
    assert isinstance(outcome, GaveUp)
    assert "but the vehicle was still for" in outcome.cause


def test_progress_follows_the_span(warm):
    _, steps = run(warm().record())
    told = [s for s in steps if isinstance(s, Progress)]
    assert told[0].current < 1.0
    assert told[-1].current > 20.0
    assert 0.0 < told[20].eta < 200.0


def test_units_without_a_thermometer_are_left_out(warm):
    recording = warm(accels=warm().accels * 2, gyros=warm().gyros * 2).record()
    one = recording.with_channels(c for c in recording.channels if (c.sensor, c.instance) != (Sensor.TEMPERATURE, 1))
    procedure, _ = run(one)
    assert {f.instance for f in procedure.outcome.results} == {0}
    assert any("gyro 2 is left out" in w for w in procedure.warnings)


def test_every_axis_that_is_not_in_the_drift_has_no_sd_beyond_the_goal(warm):
    for fit in run(warm().record())[0].outcome.results:
        goal = 0.02 if fit.sensor == Sensor.ACCEL else math.radians(0.05)
        assert max(fit.quality["drift_sd"]) <= goal


@pytest.mark.long
@settings(
    deadline=None, max_examples=3, phases=WITHOUT_SHRINKING, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cuts=st.lists(st.floats(100.0, 180.0), max_size=60))
def test_steps_and_digits_do_not_depend_on_the_chunks(warm, chunks, cuts):
    recording = warm(80.0).record()
    whole, steps = run(recording)
    cut, pieces = run(recording, chunks(recording, cuts))
    assert [repr(s) for s in steps if not isinstance(s, Done)] == [repr(s) for s in pieces if not isinstance(s, Done)]
    np.testing.assert_array_equal(whole.outcome.results[0].values, cut.outcome.results[0].values)


def test_a_temperature_that_is_repeated_does_not_grow_old(bench):
    accel = replace(bench().accels[0], thermal=ACCEL_DRIFT, noise=0.002)
    gyro = replace(bench().gyros[0], thermal=GYRO_DRIFT, noise=1e-4)
    made = bench(temperature=warming(20.0, 58.0, 30.0), accels=(accel,), gyros=(gyro,), rate=25.0).hold(100.0)
    recording = made.record()
    slow = recording.channel(Sensor.TEMPERATURE)
    t = recording.channel(Sensor.ACCEL).t
    held = replace(slow, t=t, values=slow.values[np.searchsorted(slow.t, t, side="right") - 1])
    others = [c for c in recording.channels if c.sensor != Sensor.TEMPERATURE]
    repeated, _ = run(recording.with_channels([*others, held]))
    for fit in repeated.outcome.results:
        assert fit.model.polynomial.t_min == pytest.approx(20.0)  # the first temperature, not a mean
        truth = ACCEL_DRIFT if fit.sensor == Sensor.ACCEL else GYRO_DRIFT
        assert (deviations(fit, truth) < 4.5).all()
        d = (np.linspace(22.0, 44.0, 23)[:, None] - 35.0)[..., None] ** np.arange(1, 4)
        error = (d * (fit.model.polynomial.coefficients - truth)).sum(axis=2)
        assert np.abs(error - error.mean(axis=0)).max() < 0.1 * np.abs(truth[:, 0]).max()  # a tenth of a degree


@pytest.mark.sampled
@pytest.mark.parametrize("rest", [0.4, 5.0, 30.0, 115.0])
def test_how_long_it_rests_before_it_warms_up_changes_no_drift(bench, rest):
    def curve(t):
        return 58.0 - 38.0 * np.exp(-np.maximum(t - t[0] - rest, 0.0) / 60.0)

    made = bench(
        temperature=curve,
        accels=(replace(bench().accels[0], thermal=ACCEL_DRIFT, noise=1e-3),),
        gyros=(replace(bench().gyros[0], thermal=GYRO_DRIFT, noise=5e-5),),
        rate=25.0,
    ).hold(rest + 120.0)
    recording = made.record()
    slow = recording.channel(Sensor.TEMPERATURE)
    t = recording.channel(Sensor.ACCEL).t
    sent = replace(slow, t=t, values=slow.values[np.searchsorted(slow.t, t, side="right") - 1])
    others = [c for c in recording.channels if c.sensor != Sensor.TEMPERATURE]
    procedure, _ = run(recording.with_channels([*others, sent]))
    for fit in procedure.outcome.results:
        truth = ACCEL_DRIFT if fit.sensor == Sensor.ACCEL else GYRO_DRIFT
        d = (np.linspace(20.0, 50.0, 31)[:, None] - 35.0)[..., None] ** np.arange(1, 4)
        error = (d * (fit.model.polynomial.coefficients - truth)).sum(axis=2)
        off = np.abs(error - error.mean(axis=0)).max(axis=0) / np.abs(truth[:, 0])
        assert (deviations(fit, truth) < 4.5).all()
        assert off.max() < 0.05, off  # degC
