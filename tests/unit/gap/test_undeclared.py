"""Noise that nobody declares is learned from the recording: what was in it meanwhile is no drift."""

from __future__ import annotations

import dataclasses

import numpy as np

from bench.gap_picture import REAL, recorded
from calib import gap
from calib.recording import Sensor


def test_an_offset_beside_a_larger_effect_is_no_second_order_of_it_in_a_long_recording():
    whole = recorded(REAL, 20261122, seconds=400.0, rate=100.0)
    compass, ideal = (
        tuple(c for c in channels if c.sensor is Sensor.MAG) for channels in (whole.channels, whole.reference)
    )
    report = gap.run(dataclasses.replace(whole, channels=compass, reference=ideal), nested=False)
    found = {e.id: e for e in report.effects}
    assert set(found) == {"mag_hard_iron", "mag_soft_iron"}
    np.testing.assert_allclose([p.value for p in found["mag_hard_iron"].params], REAL.mag.bias, atol=0.05)
