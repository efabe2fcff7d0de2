"""The truth that a simulated vehicle tells, against what its sensors read."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcal.service.simvehicle.verbs import truth_report

LATER_S = 2000.0
"""So long the biases have wandered: by now a gyroscope's is off by what a rest of some seconds can see."""


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_truth_told_is_that_of_this_moment(bench: Any, autopilot: str) -> None:
    b = bench(autopilot, thermal=False)
    world = b.vehicle.world
    world.restart(LATER_S)
    b.run(0.5)
    world.motion.tumble(0.0, 90.0)
    state, truth = world.state(np.array([b.vehicle.time])), truth_report(b.vehicle)
    for kind, read, true in (("accels", world.accel, state.force), ("gyros", world.gyro, state.rate)):
        for k, entry in enumerate(truth[kind]):
            told = true[0] @ np.array(entry["matrix"]).T + entry["offset"]
            assert read(k, state, noise_scale=0.0)[0] == pytest.approx(told, abs=1e-9), (kind, k)


def test_a_bias_wanders_from_the_one_drawn_and_a_reboot_does_not_bring_it_back(bench: Any) -> None:
    b = bench("ardupilot")
    drawn = b.vehicle.world.truth.gyros[0].offset
    b.vehicle.world.restart(LATER_S)
    b.run(2.0)
    before = np.array(truth_report(b.vehicle)["gyros"][0]["offset"])
    assert (np.abs(before - drawn) > 1e-6).all()
    b.vehicle.reboot(away_s=0.1)
    assert truth_report(b.vehicle)["gyros"][0]["offset"] == pytest.approx(before, abs=1e-9)


@pytest.mark.long
def test_the_truth_of_a_span_is_what_samples_of_that_span_have_in_them(bench: Any) -> None:
    b = bench("ardupilot", thermal=False)
    b.run(400.0)
    world, t = b.vehicle.world, np.linspace(100.0, 300.0, 4001)
    told = truth_report(b.vehicle, 100.0, 300.0)
    for kind in ("accels", "gyros"):
        for k, entry in enumerate(told[kind]):
            wandered = world.bias(kind, k, t)
            assert entry["offset"] == pytest.approx(wandered.mean(axis=0), abs=0.02 * float(wandered.std()))
    now = truth_report(b.vehicle)["gyros"][0]["offset"]
    assert now == pytest.approx(world.bias("gyros", 0, np.array([b.vehicle.time]))[0], abs=1e-12)
    assert now != pytest.approx(told["gyros"][0]["offset"], rel=1e-6)
