"""Sensor or flight: what two units feel alike and rest does not show is no sensor's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.gap.schema import EffectEstimate, GapReport, SeriesFit
from mavcal.calib.gap.witness import in_both_flights, not_borne_out, refuted_at_rest
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage
from tests.unit.gap.export.making import effect, report
from tests.unit.gap.synthetic import problem_of

G = 9.80665
T = np.arange(0.0, 60.0, 0.01)
FLYING = T > 20.0
REST = np.tile([0.0, 0.0, -G], (len(T), 1))


def noise(seed: int, size: float) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=(len(T), 3)) * FLYING[:, None]


def swing() -> np.ndarray:
    """What the flight asks of every accelerometer."""
    return np.column_stack([2.0 * np.sin(0.5 * T), np.cos(0.7 * T), 0.5 * np.sin(T)]) * FLYING[:, None]


def unit(k: int, values: np.ndarray, sensor: Sensor = Sensor.ACCEL, rows: slice = slice(None)) -> Channel:
    return Channel(sensor, k, T[rows], values[rows], "m/s2", Stage.FILTERED, "IMU")


def recording(*units: np.ndarray, sensor: Sensor = Sensor.ACCEL, armed: bool = True) -> Recording:
    channels = tuple(unit(k, values, sensor) for k, values in enumerate(units))
    return Recording(channels, events=(Event(20.0, "armed", ""),) if armed else ())


def told(
    one: EffectEstimate, residual: np.ndarray, part: np.ndarray | None = None, modelled: np.ndarray | None = None
) -> GapReport:
    """A report that has this effect, with what was left of its unit."""
    part = np.zeros_like(residual) if part is None else part
    modelled = part if modelled is None else modelled
    series = SeriesFit(
        one.sensor or Sensor.ACCEL, one.instances, T, residual, modelled, np.ones(3), "m/s2", {one.id: part}
    )  # fmt: skip
    return replace(report(one), series=(series,))


def test_noise_that_both_units_feel_is_of_the_air() -> None:
    air = noise(1, 0.3)
    real = recording(REST + swing() + air + noise(2, 0.02), REST + swing() + air + noise(3, 0.02))
    one = effect("accel_noise")
    assert not_borne_out(told(one, air), real) == (one,)


def test_noise_of_one_unit_is_that_units() -> None:
    own = noise(1, 0.3)
    real = recording(REST + swing() + own, REST + swing() + noise(3, 0.02))
    assert not_borne_out(told(effect("accel_noise"), own), real) == ()


def test_noise_of_every_unit_by_itself_is_theirs() -> None:
    first, second = noise(1, 0.3), noise(2, 0.3)
    real = recording(REST + first, REST + second)
    assert not_borne_out(told(effect("accel_noise", (1, 2)), first), real) == ()
    alike = recording(REST + first + noise(5, 0.01), REST + first)
    both = effect("accel_noise", (1, 2))
    assert not_borne_out(told(both, first), alike) == (both,)


def test_gyroscopes_are_asked_as_well() -> None:
    shaking = noise(4, 0.05)
    real = recording(shaking, shaking + noise(5, 0.002), sensor=Sensor.GYRO)
    one = effect("gyro_noise")
    assert not_borne_out(told(one, shaking), real) == (one,)
    assert not_borne_out(told(one, shaking), recording(shaking, noise(5, 0.002), sensor=Sensor.GYRO)) == ()


def test_an_effect_whose_unit_differs_by_it_is_that_units() -> None:
    part = 0.05 * swing()
    real = recording(REST + swing() + part + noise(1, 0.02), REST + swing() + noise(2, 0.02))
    assert not_borne_out(told(effect("accel_scale"), part, part), real) == ()


def test_an_effect_that_the_other_unit_has_too_is_of_the_flight() -> None:
    part = 0.05 * swing()
    real = recording(REST + swing() + part + noise(1, 0.02), REST + swing() + part + noise(2, 0.02))
    one = effect("accel_scale")
    assert not_borne_out(told(one, part, part), real) == (one,)


def test_an_effect_too_small_to_be_seen_in_the_units_difference_is_not_that_units() -> None:
    """The slope of noise on next to nothing is anything."""
    part = 1e-5 * swing()
    slopes = [(recording(REST + noise(k, 0.3), REST + noise(k + 50, 0.3))) for k in range(12)]
    one = effect("accel_low_pass")
    assert all(not_borne_out(told(one, part, part), real) == (one,) for real in slopes)


def test_a_steady_offset_is_compared_by_its_mean() -> None:
    offset = np.tile([0.3, -0.2, 0.1], (len(T), 1))
    felt = offset * FLYING[:, None]
    one = effect("accel_bias", bias=(0.3, -0.2, 0.1))
    apart = recording(REST + offset + noise(1, 0.05), REST + noise(2, 0.05))
    alike = recording(REST + felt + noise(1, 0.05), REST + felt + noise(2, 0.05))
    assert not_borne_out(told(one, offset, offset), apart) == ()
    assert not_borne_out(told(one, offset, offset), alike) == (one,)


def test_units_that_both_read_wrong_at_rest_are_wrong() -> None:
    part = 0.03 * (REST + swing())
    real = recording(1.03 * (REST + swing()) + noise(1, 0.01), 1.03 * (REST + swing()) + noise(2, 0.01))
    assert not_borne_out(told(effect("accel_scale", (1, 2), scale=(0.03, 0.03, 0.03)), part, part), real) == ()


@pytest.mark.parametrize(("scale", "borne_out"), [(1.03, True), (1.0, False)])
def test_of_one_unit_alone_rest_decides(scale: float, borne_out: bool) -> None:
    """Gravity before arming: a scale that is there shows, a stronger thrust does not."""
    part = 0.03 * (REST + swing())
    still = np.where(FLYING[:, None], 1.03, scale)
    real = recording((REST + swing()) * still + noise(1, 0.01))
    one = effect("accel_scale", scale=(0.03, 0.03, 0.03))
    assert not_borne_out(told(one, part, part), real) == (() if borne_out else (one,))


@pytest.mark.parametrize("off", [0.0, 0.3])
def test_gravity_at_rest_refutes_a_scale_that_the_units_difference_follows(off: float) -> None:
    """Beside what the simulator reads at rest, which may be wrong as well."""
    part = 0.05 * (REST + swing()) * FLYING[:, None]
    real = recording(REST + swing() + noise(1, 0.01), REST + swing() + part + noise(2, 0.01))
    wrong = real.with_channels(
        replace(c, values=c.values * (1.0 + off / 9.80665)) if c.instance == 1 else c for c in real.channels
    )
    one = effect("accel_scale", (2,), scale=(0.05, 0.05, 0.05))
    assert not_borne_out(told(one, part, part), wrong) == ()
    assert refuted_at_rest(told(one, part, part), wrong, wrong) == (one,)
    assert refuted_at_rest(told(one, part, part), wrong, None) == ((one,) if off == 0.0 else ())


def test_a_bias_across_gravity_is_not_refuted_by_it() -> None:
    """It tilts what is read at rest, and lengthens it by its square only: 0.56 m/s2 by 0.016."""
    offset = np.array([0.47, -0.31, 0.0])
    real = recording(REST + swing() + noise(1, 0.01), REST + swing() + offset + noise(2, 0.01))
    one = effect("accel_bias", (2,), bias=tuple(offset))
    assert refuted_at_rest(told(one, np.tile(offset, (len(T), 1))), real, None) == ()


def test_without_rest_one_unit_is_believed() -> None:
    part = 0.03 * (REST + swing())
    one = effect("accel_scale")
    assert not_borne_out(told(one, part, part), recording(REST + swing(), armed=False)) == ()


def test_other_sensors_and_other_effects_of_one_unit_are_not_asked() -> None:
    part = swing()
    real = recording(REST + swing())
    assert not_borne_out(told(effect("accel_delay"), part, part), real) == ()
    magnetic = effect("mag_hard_iron")
    assert not_borne_out(told(magnetic, part, part), real) == ()
    assert not_borne_out(report(effect("accel_noise")), real) == ()  # nothing is left of it to compare


@pytest.mark.parametrize("id_", ["gyro_misalignment", "gyro_step"])
def test_no_two_parts_are_wrong_alike(id_: str) -> None:
    """A misalignment or a step of every unit is the reference's, or the flight's; a filter serves all of them."""
    part = 0.05 * swing()
    real = recording(swing() + part, swing() + part, sensor=Sensor.GYRO)
    both = effect(id_, (1, 2))
    assert not_borne_out(told(both, part, part), real) == (both,)
    assert not_borne_out(told(effect("gyro_low_pass", (1, 2)), part, part), real) == ()


def test_a_reference_of_gravity_alone_shows_nothing_in_flight() -> None:
    part = swing()
    real = recording(REST + swing(), REST + swing())
    both = effect("accel_delay", (1, 2))
    assert not_borne_out(told(both, part, part), real) == ()
    still = told(both, part, part)
    standing = replace(still, series=(replace(still.series[0], ideal=REST),))
    assert not_borne_out(standing, real) == (both,)


def test_units_of_different_rates_are_compared_where_both_have_samples() -> None:
    air = noise(1, 0.3)
    first = unit(0, REST + air + noise(2, 0.02))
    second = unit(1, REST + air + noise(3, 0.02), rows=slice(None, None, 10))
    one = effect("accel_noise")
    assert not_borne_out(told(one, air), Recording((first, second))) == (one,)
    few = unit(1, REST, rows=slice(None, None, 200))
    assert not_borne_out(told(one, air), Recording((first, few))) == ()


MOTORS = np.array([0.3, -0.5, 0.6])


@pytest.mark.parametrize(
    ("times", "iron", "both"),
    [(0.0, 0.0, False), (0.2, 0.0, False), (1.0, 0.0, True), (1.0, 17.0, True), (1.2, -17.0, True), (-1.0, 0.0, False)],
)
def test_what_the_simulators_flight_shows_by_as_much_is_no_gap(times: float, iron: float, both: bool) -> None:
    """Halves of one flight: the motors' field of a real quad's third compass was told of the first half."""

    def field(trace):
        return times * np.outer(trace.current, MOTORS) + [iron, 0.0, 0.0]

    (trace,) = problem_of(np.random.default_rng(3), (Sensor.MAG,), field).traces
    current = effect("mag_motor_current", per_ampere=tuple(MOTORS))
    assert in_both_flights(report(current), (trace,)) == ((current,) if both else ())


@pytest.mark.parametrize(("iron", "both"), [(0.0, False), (5.0, True), (-5.0, False), (15.0, False)])
def test_an_offset_is_in_both_flights_if_the_other_has_about_the_same(iron: float, both: bool) -> None:
    (trace,) = problem_of(np.random.default_rng(3), (Sensor.MAG,), lambda _: np.array([iron, 0.0, 0.0])).traces
    offset = effect("mag_hard_iron", hard_iron=(5.0, 0.0, 0.0))
    assert in_both_flights(report(offset), (trace,)) == ((offset,) if both else ())
    assert in_both_flights(report(effect("mag_noise")), (trace,)) == ()
    assert in_both_flights(report(effect("mag_hard_iron", (2,), hard_iron=(5.0, 0.0, 0.0))), (trace,)) == ()


def test_units_of_the_simulator_that_read_the_same_show_nothing_of_one() -> None:
    first, second = problem_of(np.random.default_rng(3), (Sensor.MAG,), instances=2).traces
    equal = replace(second, measured=first.measured, ideal=first.measured, against=0)
    offset = effect("mag_hard_iron", (2,), hard_iron=(5.0, 0.0, 0.0))
    assert in_both_flights(report(offset), (equal,)) == ()
