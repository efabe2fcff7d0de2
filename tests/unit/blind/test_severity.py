from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import periodogram

from mavcal.calib.blind.effects import KNOWN, UNKNOWN
from mavcal.calib.blind.effects.noise import Drift
from mavcal.calib.blind.effects.timing import LowPass
from mavcal.calib.blind.missions import MissionKind, World, make_mission
from mavcal.calib.blind.sensors import Order, Quality, read_sensor
from mavcal.calib.blind.severity import difference, divergence, net_severity, severity, with_severity

SUITE = {"accel": Quality(0.03, 0.0048), "gyro": Quality(0.003, 0.001), "mag": Quality(0.5, 0.15, 2)}
KIND = {(k.id, k.sensor): k for k in KNOWN + UNKNOWN}


@pytest.fixture(scope="module")
def worlds() -> dict[MissionKind, World]:
    return {k: make_mission(k, np.random.default_rng(21), duration=40.0) for k in MissionKind}


def drawn(worlds, kind, target, seed=1):
    world = worlds[kind.missions[-1]]
    make = kind.draw(np.random.default_rng(seed), world, SUITE, kind.sensor)
    return world, with_severity(world, SUITE, make, kind.bounds, target)


@pytest.mark.sampled
@pytest.mark.parametrize("key", KIND, ids=lambda k: f"{k[0]}-{k[1]}")
def test_every_kind_reaches_the_severity_that_was_drawn(worlds, key):
    world, effect = drawn(worlds, KIND[key], 300.0)
    if effect is None:  # the fast rate of the grid limits how weak a filter of moved sensors can be
        assert key[0].endswith("low_pass")
        return
    tolerance = 0.05 if key[0].endswith("hold") else 0.01
    assert severity(world, SUITE, effect) == pytest.approx(300.0, rel=tolerance)
    assert net_severity(world, SUITE, effect) <= severity(world, SUITE, effect) * (1.0 + 1e-9)


def test_a_bias_has_the_severity_that_one_computes_by_hand(worlds):
    world, effect = drawn(worlds, KIND["accel_bias", "accel"], 100.0)
    b = np.array([effect.truth[f"bias.{a}"] for a in "xyz"])
    n = 40 * 200
    assert n * float(b @ b) / (0.03**2 + 0.0048**2 / 12.0) == pytest.approx(100.0, rel=1e-3)
    assert net_severity(world, SUITE, effect) == pytest.approx(0.0, abs=1e-6)


def test_noise_that_is_a_percent_louder_has_the_divergence_of_two_gaussians():
    assert divergence(np.full(1000, 1.01)) == pytest.approx(1000 * (0.01 - math.log(1.01)))


@pytest.mark.long
@pytest.mark.parametrize("flicker", [False, True], ids=["random_walk", "flicker"])
def test_the_spectrum_of_what_is_logged_is_the_one_that_severity_assumes(worlds, flicker):
    world, rng, quality = worlds[MissionKind.HOVER], np.random.default_rng(8), Quality(1.0, 0.0)
    effect = Drift("x", ("gyro",), 0.3, np.ones(3), flicker=flicker)
    n, runs = 8000, 20
    power = np.zeros(n // 2 + 1)
    for _ in range(runs):
        x = effect.noise(world, "gyro", rng.standard_normal((n, 3)), quality, rng)
        f, p = periodogram(x, fs=1.0, axis=0, window="hann", detrend="linear")
        power += p.mean(axis=1) / (2.0 * runs)  # one-sided: white noise of sd 1 gives 1
    w = 2.0 * np.pi * f[1:]
    expected = 1.0 + 0.09 * (1.0 / w if flicker else 1.0 / (4.0 * np.sin(0.5 * w) ** 2))
    for low, high in ((10, 40), (100, 400), (1000, 3900)):
        assert power[low + 1 : high + 1].mean() == pytest.approx(expected[low:high].mean(), rel=0.12)


def test_a_filter_passes_the_density_below_its_corner_and_no_more_than_half_at_it(worlds):
    world, rng, quality = worlds[MissionKind.HOVER], np.random.default_rng(9), Quality(1.0, 0.0)
    effect = LowPass("x", ("gyro",), 40.0, 2, order=Order.TIME)
    f, p = periodogram(effect.noise(world, "gyro", rng.standard_normal((8000, 3)), quality, rng), fs=200.0, axis=0)
    p = p.mean(axis=1) * 100.0
    assert p[(f > 1) & (f < 10)].mean() == pytest.approx(1.0, abs=0.1)
    assert p[(f > 38) & (f < 42)].mean() == pytest.approx(0.5, abs=0.1)


def test_what_is_logged_differs_by_what_severity_measured(worlds):
    kind = KIND["gyro_temp_linear", "gyro"]
    world, effect = drawn(worlds, kind, 2000.0)
    with_it, without = (read_sensor(world, "gyro", SUITE["gyro"], e, np.random.default_rng(4)) for e in ((effect,), ()))
    delta = difference(world, SUITE, effect, "gyro")
    # The same noise on both: only rounding is left.
    assert np.abs(with_it - without - delta).max() < 1.01 * 0.001


def test_the_limits_of_a_seed_are_physical_and_not_clipped(worlds):
    kind = KIND["accel_bias", "accel"]
    world = worlds[MissionKind.HOVER]
    make = kind.draw(np.random.default_rng(1), world, SUITE, "accel")
    assert with_severity(world, SUITE, make, (1e-5, 1e-4), 500.0) is None
