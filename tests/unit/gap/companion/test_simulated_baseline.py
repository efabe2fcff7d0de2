"""What a simulated flight shows against its own ideal is no gap of a real one that shows it as well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.companion.baselines import SimulatedBaseline, compared_with_simulator, simulated_baseline_of
from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.problem import MinimumGain
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ALPHA = 0.005
BIAS = np.array([0.2, -0.1, 0.15])
SCALE = np.array([0.03, -0.02, 0.0])


def shared(trace):
    return BIAS + trace.ideal * SCALE


def both(trace):
    return shared(trace) + np.array([0.0, 0.3, 0.0])


def flight(seed, gap=None):
    return problem_of(np.random.default_rng(seed), (Sensor.ACCEL,), gap)


@pytest.fixture(scope="module")
def simulated() -> SimulatedBaseline:
    return simulated_baseline_of(flight(1, shared), ALPHA)


def test_the_simulated_flights_own_effects_are_named_with_their_size(simulated):
    found = {e.id: e for e in simulated.effects}
    assert set(found) == {"accel_bias", "accel_scale"}
    for name, truth in (("accel_bias", BIAS), ("accel_scale", SCALE)):
        values, errors = (np.array([getattr(p, k) for p in found[name].params]) for k in ("value", "se"))
        assert (np.abs(values - truth) < 4.0 * errors).all()
    assert found["accel_bias"].instances == (1,)
    assert simulated.gains[Sensor.ACCEL] > 1000.0


def test_what_both_flights_show_is_no_gap(simulated):
    report = diagnose(compared_with_simulator(flight(2, shared), simulated), nested=False)
    assert report.verdict is GapVerdict.NO_GAP
    assert report.effects == ()


@pytest.mark.long
def test_what_only_the_real_flight_shows_is_found_in_its_own_size(simulated):
    problem = dataclasses.replace(compared_with_simulator(flight(3, both), simulated), minimum_gain=MinimumGain())
    report = diagnose(problem, nested=False)
    assert [e.id for e in report.effects] == ["accel_bias"]
    values, errors = (np.array([getattr(p, k) for p in report.effects[0].params]) for k in ("value", "se"))
    assert (np.abs(values - [0.0, 0.3, 0.0]) < 4.0 * errors + 0.02).all()


def test_what_the_simulated_flight_shows_less_than_the_real_one_must_be_clear(simulated):
    floor = compared_with_simulator(flight(2, shared), simulated).minimum_gain.steady_report
    numbers = flight(2).traces[0].ideal.size
    assert np.expm1(floor[Sensor.ACCEL] / numbers) * numbers >= 0.1 * simulated.gains[Sensor.ACCEL]
    clean = compared_with_simulator(flight(2), simulated_baseline_of(flight(2), ALPHA))
    assert clean.minimum_gain.steady_report[Sensor.ACCEL] == pytest.approx(0.03 * 3 * len(clean.traces[0].t))


def turned(trace):
    return Rotation.from_rotvec([0.05, -0.03, 0.02]).apply(trace.ideal) - trace.ideal


def drifting(trace):
    late = [np.interp(trace.t - 3e-3 * trace.t, trace.t, column) for column in trace.ideal.T]
    return np.column_stack(late) - trace.ideal


@pytest.mark.long
@pytest.mark.parametrize("gap", [turned, drifting])
def test_what_all_sensors_share_in_both_flights_is_no_gap(gap):
    first, second = (problem_of(np.random.default_rng(s), (Sensor.ACCEL, Sensor.MAG), gap) for s in (1, 2))
    report = diagnose(compared_with_simulator(second, simulated_baseline_of(first, ALPHA)), nested=False)
    assert report.effects == ()


def test_a_simulated_flight_without_a_flaw_changes_nothing():
    baseline = simulated_baseline_of(flight(4), ALPHA)
    assert baseline.effects == ()
    assert baseline.gains[Sensor.ACCEL] == 0.0
    problem = flight(2, shared)
    np.testing.assert_array_equal(compared_with_simulator(problem, baseline).traces[0].ideal, problem.traces[0].ideal)


def late(trace):
    return np.column_stack([np.interp(trace.t - 0.02, trace.t, column) for column in trace.ideal.T]) - trace.ideal


def test_noise_that_was_learned_from_the_flight_does_not_hide_its_effects():
    clean = problem_of(np.random.default_rng(1), (Sensor.GYRO,), late)
    spectrum = np.tile((clean.traces[0].residual ** 2).mean(axis=0), (2, 1))
    learned = dataclasses.replace(
        clean.traces[0], sigma=np.sqrt(spectrum[0]), sigma_dof=1e3, psd=spectrum, psd_hz=np.array([0.0, 25.0])
    )
    found = simulated_baseline_of(dataclasses.replace(clean, traces=(learned,)), ALPHA)
    plain = simulated_baseline_of(clean, ALPHA)
    assert [e.id for e in found.effects] == ["gyro_delay"]
    assert found.gains[Sensor.GYRO] == pytest.approx(plain.gains[Sensor.GYRO], rel=0.1)


@pytest.mark.parametrize("corner", [0.99, 0.9])
def test_what_is_less_than_two_flights_differ_by_is_no_flaw(corner):
    """Beside slow noise that nobody declared an effect may join for what that takes from it afterwards."""
    rng = np.random.default_rng(101)

    def slow(trace):
        noise = signal.lfilter([1.0], [1.0, -corner], rng.normal(size=trace.ideal.shape), axis=0)
        return 0.1 * noise / noise.std() + 0.01 * trace.ideal + np.array([0.08, 0.0, 0.0])

    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL,), slow)
    undeclared = dataclasses.replace(problem.traces[0], sigma=None, sigma_dof=np.inf, psd=None, psd_hz=None)
    found = simulated_baseline_of(dataclasses.replace(problem, traces=(undeclared,)), ALPHA)
    least = prices.FLIGHT_DIFFERENCE * undeclared.ideal.size
    assert all(e.evidence.two_delta_loglik >= least for e in found.effects)
    assert (found.effects == ()) is (found.changes[Sensor.ACCEL] == 0.0)


def test_a_livelier_flight_must_show_more(simulated):
    calm, lively = flight(2, shared), flight(2, shared)
    trace = lively.traces[0]
    fast = dataclasses.replace(trace, ideal=3.0 * trace.ideal, measured=3.0 * trace.measured)
    lively = dataclasses.replace(lively, traces=(fast,))
    assert (
        compared_with_simulator(lively, simulated).minimum_gain.steady_report[Sensor.ACCEL]
        > 1.5 * compared_with_simulator(calm, simulated).minimum_gain.steady_report[Sensor.ACCEL]
    )


def test_a_flight_that_moves_more_may_differ_more_but_not_in_its_level():
    """A reference errs in proportion to the movement; an offset is as easily seen in either flight."""
    calm = flight(2)
    trace = calm.traces[0]
    fast = dataclasses.replace(trace, ideal=3.0 * trace.ideal, measured=3.0 * trace.ideal + trace.residual)
    lively = dataclasses.replace(calm, traces=(fast,))
    plain = simulated_baseline_of(flight(2), ALPHA)
    before, after = (
        compared_with_simulator(calm, plain).minimum_gain,
        compared_with_simulator(lively, plain).minimum_gain,
    )
    numbers = trace.ideal.size
    assert before.steady_report[Sensor.ACCEL] == pytest.approx(prices.FLIGHT_DIFFERENCE * numbers)
    assert after.steady_report[Sensor.ACCEL] == pytest.approx(numbers * np.log1p(9.0 * prices.FLIGHT_DIFFERENCE))
    assert after.level[Sensor.ACCEL] == before.level[Sensor.ACCEL]
    calmer = compared_with_simulator(calm, simulated_baseline_of(lively, ALPHA)).minimum_gain
    assert calmer.steady_report[Sensor.ACCEL] == before.steady_report[Sensor.ACCEL]


def test_what_is_open_of_a_mean_hides_no_noise(simulated):
    """White noise of all compasses had to beat what the simulated flight's soft iron leaves open."""
    minimum_gain = compared_with_simulator(flight(2), simulated).minimum_gain
    assert minimum_gain.steady_report[Sensor.ACCEL] > 2.0 * minimum_gain.noise_entry[Sensor.ACCEL] > 0.0


def test_what_is_open_of_a_mean_is_no_unsteady_noise_of_the_sensor(simulated):
    """It was a random walk of all compasses (a hidden driver), and rotor noise of an accelerometer (no effect)."""
    thresholds = GainThresholds(compared_with_simulator(flight(2), simulated).minimum_gain)
    white, *unsteady = (
        Hypothesis(by_id()[f"accel_{n}"], (0,)) for n in ("noise", "flicker", "random_walk", "rotor_noise")
    )
    for wanders in unsteady:
        assert thresholds.to_enter(wanders) == thresholds.lasting(Sensor.ACCEL) > 2.0 * thresholds.to_enter(white)


def test_a_sensor_that_only_the_simulated_flight_has_needs_no_evidence(simulated):
    """A compass that reads one value throughout has no trace, and its simulated counterpart may have effects."""
    without = problem_of(np.random.default_rng(2), (Sensor.GYRO,))
    minimum_gain = compared_with_simulator(without, simulated).minimum_gain
    assert minimum_gain.steady_report[Sensor.ACCEL] == 0.0
    assert minimum_gain.steady_report[Sensor.GYRO] > 0.0


def test_a_simulated_flight_that_is_much_calmer_is_said():
    calm = flight(2)
    trace = calm.traces[0]
    fast = dataclasses.replace(trace, ideal=4.0 * trace.ideal, measured=4.0 * trace.ideal + trace.residual)
    lively = dataclasses.replace(calm, traces=(fast,))
    plain = simulated_baseline_of(calm, ALPHA)
    (said,) = compared_with_simulator(lively, plain).warnings
    assert said.startswith("accel: this flight moves 4 times as much as the other one")
    assert compared_with_simulator(calm, plain).warnings == ()


def test_noise_is_learned_beside_the_nuisance_effects(simulated):
    traces = flight(4, shared).traces
    (left,) = simulated.added_to_ideal(traces)
    assert np.sqrt((left.residual**2).mean()) == pytest.approx(0.05, rel=0.05)
    assert np.sqrt((traces[0].residual ** 2).mean()) > 0.1
