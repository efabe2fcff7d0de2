from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.cases import FAMILIES, KNOWN, Tier, family, make_case, make_label, split
from mavcal.calib.blind.render import recording
from mavcal.calib.blind.seal import generator_sha256, labels_sha256, seeds
from mavcal.calib.recording import Sensor


@pytest.fixture(scope="module")
def single():
    return make_case(Tier.SINGLE, 2)


@pytest.mark.long
def test_a_case_is_its_seed(single):
    again = make_case(Tier.SINGLE, 2)
    assert again.label == single.label == make_label(Tier.SINGLE, 2)
    assert all(np.array_equal(single.real[k], again.real[k], equal_nan=True) for k in single.real)
    assert labels_sha256([single.label]) == labels_sha256([again.label])


def test_the_columns_tell_nothing_of_what_was_put_in(single):
    assert set(single.real) == set(single.sim)
    null = make_case(Tier.NULL, 2)
    assert set(null.real) == set(single.real)
    assert len(single.id) == len(null.id) == 16


def test_a_null_differs_from_its_reference_by_its_noise_and_from_its_simulation_by_both():
    case = make_case(Tier.NULL, 7)
    sd, step, _ = case.label["suite"]["gyro"]
    expected = np.sqrt(sd**2 + step**2 / 12.0)
    for columns in (case.real, case.sim):
        left = columns["gyro_x"] - columns["ref_gyro_x"]
        assert left.std() == pytest.approx(expected, rel=0.03)
        assert abs(left.mean()) < 5.0 * expected / np.sqrt(len(left))
    both = case.real["gyro_x"] - case.sim["gyro_x"]
    assert both.std() == pytest.approx(np.sqrt(2.0) * expected, rel=0.03)


def test_a_single_effect_can_be_read_off_the_logs_by_least_squares():
    case = make_case(Tier.LADDER, 8)
    assert case.label["effects"][0]["id"] == "accel_bias"
    sd, step, _ = case.label["suite"]["accel"]
    for axis in "xyz":
        left = case.real[f"accel_{axis}"] - case.real[f"ref_accel_{axis}"]
        error = left.mean() - case.label["effects"][0]["params"][f"bias.{axis}"]
        assert abs(error) < 5.0 * np.hypot(sd, step / np.sqrt(12.0)) / np.sqrt(len(left))


def test_the_recording_keeps_each_rate(single):
    made = recording(single.real, "real")
    assert len(made.channel(Sensor.TEMPERATURE)) == 1400
    assert len(made.channel(Sensor.GYRO)) == 14000
    assert {c.sensor for c in made.reference} == {
        *(Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.ATTITUDE, Sensor.PLACE, Sensor.VELOCITY)
    }


def test_development_and_sealed_seeds_do_not_mix():
    assert list(seeds(999_998, 2)) == [999_998, 999_999]
    with pytest.raises(ValueError, match="mix"):
        seeds(999_998, 3)


def test_every_known_kind_has_one_family_and_the_hash_sees_the_files():
    for kind in KNOWN:
        assert sum(split(kind.id)[1] in f for f in FAMILIES) == 1
        assert kind.id in family(kind.id)
    assert len(generator_sha256()) == 64
