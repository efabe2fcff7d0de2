"""On which of two units an effect is reported."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.gap.schema import ParameterEstimate
from mavcal.calib.gap.telling.effect_report import delay_on_late_unit, with_other_unit_as_rival
from mavcal.calib.recording import Sensor
from tests.unit.gap.export.making import effect

UNITS = (1, 2)


def delayed(by, se=0.001, unit=2):
    """A gyroscope that is late; a negative delay is a lead."""
    delay = ParameterEstimate("delay_s", by, se, (by - 2.0 * se, by + 2.0 * se), "s")
    return replace(effect("gyro_delay"), sensor=Sensor.GYRO, instances=(unit,), params=(delay,))


@given(by=st.floats(0.003, 0.4), unit=st.sampled_from(UNITS))
def test_a_unit_that_leads_the_trajectory_is_in_time_and_the_other_is_late(by, unit):
    found = delay_on_late_unit(delayed(-by, unit=unit), UNITS)
    assert found.instances == (3 - unit,)
    assert (found.params[0].value, found.params[0].se) == (by, 0.001)
    assert found.params[0].ci95 == pytest.approx((by - 0.002, by + 0.002))
    assert delay_on_late_unit(found, UNITS) == found


def test_a_unit_that_is_late_or_may_be_in_time_stays_the_one():
    for by in (0.02, 0.001, -0.001, -0.002):
        assert delay_on_late_unit(delayed(by), UNITS) == delayed(by)


@pytest.mark.parametrize("units", [(2,), (1, 2, 3)])
def test_of_one_unit_or_of_three_a_lead_stays_where_it_is(units):
    assert delay_on_late_unit(delayed(-0.02), units) == delayed(-0.02)


def test_a_negative_amplitude_of_another_effect_is_no_lead():
    biased = effect("accel_bias", bias=(-0.3, -0.2, -0.1))
    assert delay_on_late_unit(biased, UNITS) == biased


def test_what_either_unit_may_have_has_its_part_of_the_probability_and_names_the_other():
    biased = replace(effect("accel_bias", bias=(0.3, 0.0, 0.0)), instances=(1,))
    doubted = with_other_unit_as_rival(biased, UNITS, 0.6)
    assert doubted.evidence.probability == 0.6 * biased.evidence.probability
    assert (doubted.instances, doubted.params) == (biased.instances, biased.params)
    assert "instance 2 may have it instead" in doubted.confusable_with[0].fix
    assert doubted.confusable_with[1:] == biased.confusable_with
