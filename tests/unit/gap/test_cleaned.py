"""Readings without the errors of an axis that a report is sure of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.gap.cleaned import without_matrix_errors
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from tests.unit.gap.export.making import effect, report

T = np.arange(0.0, 10.0, 0.01)
TURNS = np.column_stack([np.sin(T), np.cos(T), np.sin(0.5 * T)])
SCALE = (-0.06, -0.06, 0.03)


def units() -> Recording:
    read = (TURNS * (1.0 + np.array(SCALE)), TURNS)
    made = tuple(Channel(Sensor.GYRO, k, T, v, "rad/s", Stage.FILTERED, "IMU") for k, v in enumerate(read))
    return Recording(made, dynamics=made[:1])


def test_a_scale_that_is_sure_is_taken_off_its_own_unit() -> None:
    right = without_matrix_errors(units(), report(effect("gyro_scale", (1,), scale=SCALE)))
    assert right is not None
    for channel in (*right.channels, *right.dynamics):
        assert channel.values == pytest.approx(TURNS)


def test_what_is_in_doubt_or_no_matrix_stays() -> None:
    scale = effect("gyro_scale", (1,), scale=SCALE)
    doubtful = replace(scale, evidence=replace(scale.evidence, probability=0.5))
    others = (effect("gyro_bias", (1,), bias=(0.1, 0.1, 0.1)), effect("mag_soft_iron", (1,)))
    assert without_matrix_errors(units(), report(doubtful, *others)) is None
