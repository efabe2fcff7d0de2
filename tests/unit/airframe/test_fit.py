"""One flight against the model: parameters that made it are found again, with errors that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from mavcal.calib.airframe.effects import AirframeEffect, catalogue, nameless
from mavcal.calib.airframe.fit import FlightFit, FlightLikelihood, excited, expanded, fitted, spectra_of
from mavcal.calib.airframe.flown import FlownFlight, Rest
from mavcal.calib.airframe.nameless import PREFIX
from mavcal.calib.airframe.pair import PairEvidence, Side, by_itself
from mavcal.calib.airframe.physics import Airframe, Kind, Layout
from mavcal.calib.airframe.priors import prior_of
from mavcal.calib.airframe.searched import with_limit
from mavcal.calib.airframe.signals import kept_below, spline
from mavcal.calib.inference.search import search
from tests.unit.airframe.made import HZ, G, airframe, flight, theta

N = 4000
KIND = Kind(drag_by_rotor=False)
TRUE = {
    "k": 25.0, "expo": 0.6, "c1": 0.25, "c2": 0.03, "cz": 0.25, "gain_x": 200.0, "gain_y": 180.0, "gain_z": 8.0,
    "tau": 0.03, "wind_north": 1.0, "wind_east": -2.0,
}  # fmt: skip


def told(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands and velocity of 40 s: doublets, yaw steps, throttle steps and runs; the heading turns slowly."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / HZ
    c = 0.5 + 3e-4 * rng.normal(size=(N, 4))
    for start, way, size in ((4, (-1, 1, 1, -1), 0.1), (9, (1, -1, 1, -1), 0.1), (14, (1, 1, -1, -1), 0.2)):
        rows = (t > start) & (t < start + 3.0)
        c[rows] += size * np.sign(np.sin((7.0 + seed) * (t[rows] - start)))[:, None] * np.array(way)
    rows = (t > 20.0) & (t < 30.0)
    c[rows] += 0.12 * np.sign(np.sin(2.5 * (t[rows] - 20.0)))[:, None]
    velocity = np.column_stack([9.0 * np.sin(0.5 * t + seed), 8.0 * np.cos(0.37 * t), 2.0 * np.sin(0.9 * t)])
    half = 0.5 * (0.2 * t + seed)
    return c, velocity, np.column_stack([np.cos(half), 0.0 * t, 0.0 * t, np.sin(half)])


def flew(seed: int = 0, slew: float | None = None, **changes: float) -> FlownFlight:
    """The flight that a vehicle with these parameters makes, with the noise of its sensors."""
    c, velocity, q = told(seed)
    bare = flight(c, velocity=velocity, q=q)
    model = Airframe(bare, KIND, None, slew=slew)
    force, torque = model.predicted(theta(model, **{**TRUE, **changes}))
    rng = np.random.default_rng(50 + seed)
    rate = np.cumsum(0.5 * (torque[1:] + torque[:-1]), axis=0) / HZ
    noise = 2e-4 * rng.normal(size=(N, 3))
    rate, turning = np.vstack([np.zeros((1, 3)), rate]) + noise, torque + np.gradient(noise, 1.0 / HZ, axis=0)
    slow = lfilter([0.02], [1.0, -0.98], rng.normal(size=(N, 3)), axis=0)
    return replace(bare, force=force + 0.02 * rng.normal(size=(N, 3)) + 0.02 * slow, rate=rate, acceleration=turning)


def side(one: FlownFlight, *, torque: bool = True) -> Side:
    likelihood = FlightLikelihood(airframe(one, kind=KIND, volts=None), one.usable, torque=torque)
    return Side(likelihood, expanded(likelihood, by_itself(likelihood), likelihood.possible))


@pytest.fixture(scope="module")
def simulated() -> Side:
    return side(flew(0))


def test_parameters_that_made_a_flight_are_found(simulated: Side) -> None:
    fit = simulated.fit
    assert isinstance(fit, FlightFit)
    for name, size in (("k", 0.01), ("expo", 0.02), ("c1", 0.05), ("c2_x", 0.1), ("gain_x", 0.05), ("gain_y", 0.05)):
        assert fit.value(name) == pytest.approx(TRUE["c2" if name == "c2_x" else name], rel=size)
        assert fit.sd(name) < prior_of(name)[1]
    assert fit.value("tau") == pytest.approx(0.03, abs=0.004)
    assert (fit.value("wind_north"), fit.value("wind_east")) == (
        pytest.approx(1.0, abs=0.2), pytest.approx(-2.0, abs=0.2),
    )  # fmt: skip


def test_residuals_are_what_is_left_and_only_where_it_is_judged() -> None:
    one = flew(1)
    usable = np.ones(N, dtype=bool)
    usable[500:700] = False
    found = side(replace(one, usable=usable), torque=False).fit
    assert found.residual.shape == (N, 6)
    assert np.isnan(found.residual[500:700]).all()
    assert np.isfinite(found.residual[usable]).all()
    assert found.residual[usable, 0].std() == pytest.approx(0.02, rel=0.2)
    assert np.linalg.eigvalsh(found.curvature).min() > -1e-6 * np.abs(found.curvature).max()


def test_every_parameter_has_a_prior_and_a_place() -> None:
    layout = Layout(8, ("free_curve:1", "free_slow_torque:1"))
    assert len(set(layout.names)) == len(layout.names)
    for name in layout.names:
        _, sd = prior_of(name)
        assert sd > 0.0
        assert layout.names[layout.place[name]] == name


def test_turns_and_climbs_are_where_they_are_commanded() -> None:
    one = flew(0)
    turns, lifts = excited(one)
    t = one.t
    assert turns[(t > 4.5) & (t < 6.5)].mean() > 0.9
    assert lifts[(t > 20.5) & (t < 29.5)].mean() > 0.3
    for rows in (turns, lifts):
        assert not rows[(t > 32.0)].any()
    assert not lifts[(t > 4.5) & (t < 17.0)].any()


def test_a_spectrum_is_the_variance_of_its_neighbourhood() -> None:
    rng = np.random.default_rng(1)
    level = np.where(np.arange(8000) < 2000, 3.0, 1.0)
    (found,) = spectra_of([level * rng.normal(size=8000)])
    assert found[200:1500].mean() == pytest.approx(9.0, rel=0.1)
    assert found[4000:].mean() == pytest.approx(1.0, rel=0.1)
    assert found.min() > 0.0


@pytest.mark.parametrize(
    ("scale", "name", "mean"), [(1.0, "bias_z", 0.0), (1.001, "bias_z", -0.001 * G), (1.03, "scale", 0.03)]
)
def test_gravity_at_rest_bounds_the_accelerometer(scale: float, name: str, mean: float) -> None:
    """A little is an offset, which is then known; much of it may be a scale."""
    rest = Rest({0: np.array([0.0, 0.0, -G * scale])}, 0.01)
    one = replace(flew(0), rest=rest)
    likelihood = FlightLikelihood(airframe(one, kind=KIND), one.usable, torque=False)
    assert likelihood.prior(name)[0] == pytest.approx(mean, abs=1e-9)
    unseen = FlightLikelihood(airframe(flew(0), kind=KIND), one.usable, torque=False)
    assert likelihood.prior("bias_z") == (pytest.approx(G * (1.0 - scale), abs=1e-9), rest.sd)
    assert unseen.prior("bias_z")[1] > 3.0 * rest.sd
    assert unseen.prior("k") == prior_of("k")


@pytest.mark.parametrize("rate", [125.0, 250.0, 400.0])
def test_white_noise_of_a_gyroscope_is_what_it_is_at_any_rate(rate: float) -> None:
    """Not a part of it, by bands near the grid's end: half was taken for what a controller answers."""
    rng = np.random.default_rng(11)
    stamps = np.arange(0.0, N / HZ, 1.0 / rate)
    noise = kept_below(0.1 * rng.normal(size=(len(stamps), 3)), rate, HZ)
    one = flew(0)
    one = replace(one, acceleration=one.acceleration + spline(stamps, noise)(one.t, 1), inertial_hz=rate)
    likelihood = FlightLikelihood(airframe(one, kind=KIND, volts=None), one.usable, torque=True)
    np.testing.assert_allclose(likelihood.noise.power, 0.01 * HZ / rate, rtol=0.2)


@pytest.mark.parametrize("corner", [20.0, 30.0, 60.0])
def test_a_filter_that_no_log_states_is_not_taken_for_quiet_sensors(corner: float) -> None:
    """Two thirds of the noise were missed behind a filter of 20 Hz, and a product of inertia was not found."""
    rng = np.random.default_rng(13)
    stamps = np.arange(0.0, N / HZ, 1.0 / 400.0)
    noise = sosfilt(butter(2, corner, fs=400.0, output="sos"), 0.2 * rng.normal(size=(len(stamps), 3)), axis=0)
    one = flew(0)
    turned = spline(stamps, kept_below(noise, 400.0, HZ))(one.t, 1)
    one = replace(one, acceleration=one.acceleration + turned, inertial_hz=400.0)
    likelihood = FlightLikelihood(airframe(one, kind=KIND, volts=None), one.usable, torque=True)
    np.testing.assert_allclose(likelihood.noise.power, 0.04 * HZ / 400.0, rtol=0.35)


def test_turns_are_judged_where_they_stand_out_of_the_noise() -> None:
    rng = np.random.default_rng(12)
    quiet = replace(flew(0), inertial_hz=400.0)
    noise = np.gradient(0.5 * rng.normal(size=(N, 3)), 1.0 / HZ, axis=0)
    loud = replace(quiet, acceleration=quiet.acceleration + noise)
    heard = [
        [FlightLikelihood(airframe(f, kind=KIND, volts=None), f.usable, torque=True).heard(k) for k in (3, 4, 5)]
        for f in (quiet, loud)
    ]
    assert min(heard[0]) > 15.0
    assert max(heard[1]) < 14.0


def test_a_flight_without_torque_says_nothing_of_turns() -> None:
    one = flew(0)
    likelihood = FlightLikelihood(airframe(one, kind=KIND), one.usable, torque=False)
    layout = likelihood.airframe.layout
    assert not likelihood.possible[[layout.place[n] for n in ("gain_x", "damping_z", "cg_x", "torque_y")]].any()
    assert likelihood.possible[[layout.place[n] for n in ("k", "c1", "wind_east")]].all()
    assert not likelihood.possible[layout.place["sag"]]  # the voltage stays


def effects(of: Side) -> tuple[AirframeEffect, ...]:
    layout = of.fit.layout
    named = catalogue(layout, Kind(drag_by_rotor=False), (200.0, 180.0, 8.0))
    return (*(e for e in named if not e.slew and e.id != "battery_sag"), *nameless(layout))


def limits(of: Side) -> tuple[AirframeEffect, ...]:
    """The catalogue with the limit of a motor's rate."""
    named = catalogue(of.fit.layout, Kind(drag_by_rotor=False), (200.0, 180.0, 8.0))
    return (*effects(of), *(e for e in named if e.slew))


PAIRS: list[tuple[dict[str, float], set[str]]] = [
    ({}, set()),
    ({"k": 22.5, "gain_x": 180.0, "gain_y": 162.0, "gain_z": 7.2}, {"thrust_scale"}),
    ({"c1": 0.4, "cz": 0.4, "weak_2": -0.1}, {"rotor_drag", "motor_weak_2"}),
]


@pytest.mark.parametrize(
    ("changes", "known"),
    [
        pytest.param(*PAIRS[0], id="nothing"),
        pytest.param(*PAIRS[1], id="thrust", marks=pytest.mark.long),
        pytest.param(*PAIRS[2], id="drag and a motor"),
    ],
)
def test_what_the_real_flight_has_beside_the_simulated_one_is_found(
    simulated: Side, changes: dict[str, float], known: set[str]
) -> None:
    answer = search(PairEvidence(side(flew(1, **changes)), simulated, effects(simulated)))
    found = {b.name for b in answer.blocks if answer.probability(b.name) > 0.5} - {"wind"}
    assert found == known
    for name in known:
        mean, covariance = answer.amplitudes(name)
        size = {"thrust_scale": -0.1, "rotor_drag": 0.6, "motor_weak_2": -0.1}[name]
        assert abs(mean[0] - size) < 3.0 * np.sqrt(covariance[0, 0])
    real, sim = answer.evidence.parameters(answer.best.model, answer.best.posterior)  # type: ignore[attr-defined]
    place = simulated.fit.layout.place
    assert real[place["k"]] / sim[place["k"]] == pytest.approx(changes.get("k", 25.0) / 25.0, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("wind", [1.0, 7.0])
def test_a_limit_on_the_rate_of_a_command_is_found_in_any_wind(simulated: Side, wind: float) -> None:
    real = side(flew(1, slew=2.2, wind_north=wind))
    limited = with_limit(real, simulated, limits(simulated))
    assert limited is not None
    assert limited[1] == pytest.approx(2.2, rel=0.1)
    told = search(PairEvidence(real, simulated, limits(simulated), limited[0]))
    assert "motor_slew" in told.best.model


@pytest.mark.long
def test_no_limit_is_found_where_there_is_none(simulated: Side) -> None:
    assert with_limit(side(flew(1)), simulated, limits(simulated)) is None


def test_the_models_own_error_is_in_both_flights(simulated: Side) -> None:
    """Without effects it does not matter which flight is the real one."""
    other = side(flew(1))
    one, two = (PairEvidence(*pair, ()).posterior(frozenset()) for pair in ((other, simulated), (simulated, other)))
    assert one.log_evidence == pytest.approx(two.log_evidence, abs=0.1)


@pytest.mark.parametrize(
    ("name", "beyond", "end"),
    [
        ("expo", 1.35, 1.2),
        pytest.param("spin_up", 1.5, 1.0, marks=pytest.mark.long),
        pytest.param("cg_x", 0.8, 0.5, marks=pytest.mark.long),
    ],
)
def test_a_parameter_at_its_end_leaves_the_others_at_their_best(name: str, beyond: float, end: float) -> None:
    one = airframe(flew(3, **{name: beyond}), kind=KIND, volts=None)
    likelihood = FlightLikelihood(one, one.flight.usable, torque=True)
    still = {n: 0.0 for n in one.layout.names if n.startswith(("weak_", "pulse_", "load", "fall", "product_", PREFIX))}
    free, held = (fitted(likelihood, one.layout.start(0.5, G), {**still, **also}, 40) for also in ({}, {name: end}))
    assert free.value(name) == pytest.approx(end)
    best = likelihood.loglik(held.theta, held.spectra)
    assert likelihood.loglik(free.theta, held.spectra) == pytest.approx(best, abs=1.0)


def test_a_flight_that_never_stands_out_from_its_usual_commands_is_fitted_all_the_same() -> None:
    """Then there is no row in which fast forces or torques are judged."""
    usual = 0.5 + 0.01 * np.sign(np.sin(9.0 * np.arange(N) / HZ))[:, None] * np.ones((1, 4))
    one = replace(flew(0), c=usual)
    assert not any(rows.any() for rows in excited(one))
    found = by_itself(FlightLikelihood(airframe(one, kind=KIND), one.usable, torque=True))
    assert np.isfinite(found).all()
